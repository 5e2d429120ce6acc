#version 330 core
// transmission: position, normal_geometry, albedo, skin, shadow_N, _baked, curvature
//   -> thickness_mm (R32F), transmittance (RGB), transmission (RGB radiance, added over lamps).
// Jimenez et al. 2010, with T(d) = sum w exp(-d^2 / 2v): their exp(-d^2 / v) is the wrong plane
// integral (0.305 for 0.406 in red at 1 mm). T is averaged over the taps, not d: mean T(d) != T(mean
// d). d is clamped with max(0, .), never abs(), which would turn acne into glow.
// Light below a bias of skin is the lit face itself, which irradiance already holds. Where the light
// grazes, texels of a coarse map do not tell the two apart: asked to, they showed as noise.
// BAKED: d is the asset's thickness along the normal; light enters where that comes out behind, unless
// something hides that point. CURVATURE: T is scaled by curvature, a mistake that figure 9 shows.
// Check alone: thickness_mm is small at ears only; transmission is black on the lit side.
#include "common.glsl"
#include "light.glsl"
#include "shadow_lookup.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D transmittance_table;  // T over sqrt(d / opaque_mm), from the profile's closed form
uniform float opaque_mm;       // T is nothing beyond this
uniform float least_bias_mm;   // mm, the receiver is moved this far along -N, or more
uniform float blur_mm;         // mm, radius of the average in the light's view
uniform float texel_mm;
uniform float wrap;            // light enters past the terminator: 0 physical
uniform float far_mm;          // thickness where the light never entered
uniform bool use_skin;
uniform int tap_count;
uniform float turn;
uniform bool shares_taps;
#ifdef BAKED
uniform sampler2D baked;       // g: mm
uniform bool has_shadow;
#endif
#ifdef CURVATURE
uniform sampler2D curvature;   // 1/mm
uniform vec4 width_by_curvature;
#endif

layout(location = 0) out vec4 transmission;
layout(location = 1) out float thickness_mm;
layout(location = 2) out vec4 transmittance;

vec3 transmittance_at(float d) {
    float size = float(textureSize(transmittance_table, 0).x);
    float u = (sqrt(d / opaque_mm) * (size - 1.0) + 0.5) / size;
    return textureLod(transmittance_table, vec2(u, 0.5), 0.0).rgb;
}

#ifdef BAKED
// d of the map; its light is what reaches the back, p - n d, past what stands before it.
vec3 crossing(vec3 p, vec3 n, vec3 l, ivec2 here) {
    float d = texelFetch(baked, here, 0).g;
    thickness_mm = d;
    vec3 t = d >= opaque_mm ? vec3(0.0) : transmittance_at(d);
    if (!has_shadow || d >= opaque_mm) return t;
    LightPoint back = light_point(p - n * d, n);
    if (!back.in_map) return t;  // nothing tells what stands before it
    // The back leans and bends: the map's d does not lead to it exactly.
    float slack = max(least_bias_mm, 0.5 * d) + texel_mm;
    float seen = 0.0;
    vec2 own = spiral_here(turn, shares_taps);
    for (int i = 0; i < tap_count; ++i) {
        vec2 offset = disk_point(i, tap_count, own) * max(blur_mm, texel_mm);
        float first = first_depth(back, offset);
        seen += first < plane_depth(back, offset) - slack ? 0.0 : 1.0;
    }
    return t * seen / float(tap_count);
}
#else
// Two texels on a slope, none where the light falls straight.
float bias_of(LightPoint p) {
    return max(least_bias_mm, 2.0 * texel_mm * min(dot(p.slope, p.slope), 1.0));
}

vec3 crossing(vec3 p, vec3 n, vec3 l, ivec2 here) {
    float bias_mm = bias_of(light_point(p, n));
    LightPoint inside = light_point(p - n * bias_mm, n);
    if (!inside.in_map) return vec3(0.0);  // no map tells how thick it is there

    bool away = dot(l, n) < 0.0;
    // The receiver was moved toward the light; the light still has to cross that much more.
    float buried = bias_mm * max(0.0, -dot(l, n));
    vec3 t = vec3(0.0);
    float thickness = 0.0;
    float paths = 0.0;
    vec2 own = spiral_here(turn, shares_taps);
    for (int i = 0; i < tap_count; ++i) {
        vec2 offset = disk_point(i, tap_count, own) * max(blur_mm, texel_mm);
        float entry = first_depth(inside, offset);
        // Away from the light, a tap that enters deeper than the point itself (or nowhere) tells of
        // no path through skin: it counts as thick. On the lit side it is the lit face, 0 thick.
        // Taps beside the point meet its own tilted plane: its depth there counts.
        float exit = plane_depth(inside, offset);
        bool no_path = away && entry > exit + bias_mm;
        float d = no_path ? far_mm : max(0.0, exit - entry) * inside.way_per_depth + buried;
        // What is told is the way through skin where there is one: a rim's taps beside it have none.
        thickness += no_path ? 0.0 : d;
        paths += no_path ? 0.0 : 1.0;
        // Fading in over one more bias keeps the terminator smooth when `wrap` lights it.
        t += d >= opaque_mm ? vec3(0.0) : smoothstep(bias_mm, 2.0 * bias_mm, d) * transmittance_at(d);
    }
    thickness_mm = paths > 0.0 ? thickness / paths : far_mm;
    return t / float(tap_count);
}
#endif

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    transmission = vec4(0.0);
    transmittance = vec4(0.0);
    thickness_mm = 0.0;
    if (p.a == 0.0) return;
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;
    vec3 l = direction_to_light(p.xyz);
    float back = max(0.0, wrap - dot(l, n));
    if (back == 0.0) return;  // the lit face: nothing to cross
    vec3 t = crossing(p.xyz, n, l, here);
#ifdef CURVATURE
    float bent = min(max(texelFetch(curvature, here, 0).r, 0.0) * width_by_curvature.z, 1.0);
    // A share of the light: `increase` doubles what thin skin lets through, up to all there is.
    t = min(t * (width_by_curvature.x + width_by_curvature.y * bent), vec3(1.0));
#endif
    transmittance = vec4(t, 1.0);

    float s = use_skin ? texelFetch(skin, here, 0).r : 1.0;
    vec3 a = texelFetch(albedo, here, 0).rgb;
    transmission = vec4(a * t * incident_irradiance(p.xyz) * (back * s), 0.0);
}
