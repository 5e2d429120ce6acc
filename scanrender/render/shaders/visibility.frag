#version 330 core
// visibility: position, normal_geometry, normal_shading, shadow_N -> visibility_N (R32F, 0 to 1).
// Percentage-closer filtering over a golden-angle disk; each tap is compared with the receiver's own
// tangent plane at the tap's texel, so that neither a wide filter nor a coarse map darkens a lit
// slope. With a size of the light, the disk is the penumbra w = size (d - d_blocker) for parallel
// light, size (d - d_blocker) / d_blocker for a lamp (Fernando 2005, "Percentage-Closer Soft
// Shadows"): sharp at contact. Where the normal map turns a pixel to a light that its surface
// turns from, light fades as in Chiang et al. 2019, "Taming the Shadow Terminator".
// Limit: blockers are averaged, so two of them at different depths share one penumbra.
// Check alone: visibility_0 is a clean stencil of the lit side, without stripes (acne).
#include "common.glsl"
#include "light.glsl"
#include "shadow_lookup.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform sampler2D normal_shading;
uniform float blur_mm;      // mm, least radius of the soft edge
uniform float light_size;   // tangent of the half angle, or mm; without SIZED the edge is blur_mm
uniform float reach_mm;     // mm, widest penumbra that is looked for
uniform float texel_mm;     // mm, one shadow map texel at the subject's centre
uniform int taps;
uniform int search_taps;
uniform float turn;         // radians, differs per supersample so that their average is finer
uniform bool shares_taps;   // with its neighbours: light that scatters in a picture of half the size

layout(location = 0) out float visibility;

// What the receiver's curvature and facets may rise above its tangent plane at this offset, mm.
// Two degrees, but never so much that a chin would not shade the throat below it.
float tolerance(LightPoint p, vec2 offset) {
    float facets = 0.03 * (1.0 + dot(p.slope, p.slope)) * length(offset);
    return texel_mm * 0.5 + min(facets, 4.0 * texel_mm);
}

// A disk on the receiver's tangent plane, seen from the light: where light grazes, a round one would
// reach far up and down the slope.
vec2 on_surface(LightPoint p, vec2 offset) {
    float squared = dot(p.slope, p.slope);
    if (squared < 1e-12) return offset;
    float narrower = 1.0 - inversesqrt(1.0 + squared);
    return offset - p.slope * (dot(offset, p.slope) / squared * narrower);
}

// Radius at the receiver of the shadow's edge that something at this depth casts.
float penumbra_mm(float depth, float blocker) {
    float gap = depth - blocker;
    return light_size * (light_is_near ? gap / max(blocker + light_distance_mm - light_front_mm, 1e-3) : gap);
}

bool is_blocked(LightPoint p, vec2 offset, float first, float share_of_cone) {
    if (first >= plane_depth(p, offset) - tolerance(p, offset)) return false;
#ifdef SIZED
    // Beside the cone from the point to the light, nothing is in the way, however high it stands.
    return length(offset) * share_of_cone <= penumbra_mm(p.depth_mm, first) + texel_mm;
#else
    return true;
#endif
}

// Radius of the penumbra at this point, -1 where nothing is in the way.
float search(LightPoint p) {
    float widest = clamp(penumbra_mm(p.depth_mm, 0.0), texel_mm, reach_mm);
    float sum = 0.0;
    float count = 0.0;
    vec2 own = spiral_here(turn, shares_taps);
    for (int i = 0; i < search_taps; ++i) {
        // Denser toward the middle (as 1/r), where the low blockers of a contact are.
        vec2 offset = disk_point(i, search_taps, own);
        offset *= widest * length(offset);
        float first = first_depth(p, offset);
        if (is_blocked(p, offset, first, 1.0)) {
            sum += first;
            count += 1.0;
        }
    }
    return count == 0.0 ? -1.0 : penumbra_mm(p.depth_mm, sum / count);
}

// Share of light where the geometry turns away before the shading normal does.
float horizon(vec3 n, vec3 shading, vec3 l) {
    float geometric = dot(n, l);
    float shaded = dot(shading, l);
    if (geometric <= 0.0 || shaded <= 0.0) return 0.0;
    float g = min(1.0, geometric / (shaded * max(dot(n, shading), 1e-3)));
    return g * (1.0 + g * (1.0 - g));
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    visibility = 0.0;
    if (p.a == 0.0) return;
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;
    float share = horizon(n, texelFetch(normal_shading, here, 0).xyz, direction_to_light(p.xyz));
    if (share == 0.0) return;

    // Leave the surface a little: what the map cannot resolve must not shadow itself.
    LightPoint lit = light_point(p.xyz + n * 0.5 * texel_mm, n);
    // Only a lamp inside the subject's bounds has a map that misses something; that is lit.
    visibility = share;
    if (!lit.in_map) return;
    float radius_mm = max(blur_mm, texel_mm);
#ifdef SIZED
    float penumbra = search(lit);
    if (penumbra < 0.0) return;
    radius_mm = clamp(penumbra, radius_mm, max(reach_mm, radius_mm));
#endif
    float sum = 0.0;
    vec2 own = spiral_here(turn, shares_taps);
    for (int i = 0; i < taps; ++i) {
        vec2 offset = on_surface(lit, disk_point(i, taps, own) * radius_mm);
        float first = first_depth(lit, offset);
        sum += is_blocked(lit, offset, first, 0.5) ? 0.0 : 1.0;
    }
    visibility = share * sum / float(taps);
}
