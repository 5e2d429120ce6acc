#version 330 core
// disk: diffusion_input, depth_mm, normal_geometry -> scattered (premultiplied): the surface integral
// M(p) = sum of R(|x_q - x_p|) E(q) dA(q), for any profile, over taps in the tangent plane of p.
// A tap stands for a ring of the profile: on that plane its weight is the ring's energy, exactly, at
// any tilt. The surface that the picture has there lies off the plane, so the weight is changed by
//   R(r3) / R(r2)      r3 the distance in space, r2 the ring's radius: a depth step ends it
//   dA(q) / dA(plane)  (z_q / z)^2 |n_p.w| / |n_q.w|: what the pixel shows of surface and of plane
// (DESIGN 4; engines omit the second: 1.38 : 1 along and across a slope of 75 degrees.)
// Taps begin all over the pixel, whose mean the light is, not at its centre.
// At grazing angles the plane is turned to the eye as far as least_cosine says: edge on it has no taps.
// Normalized by what was met, or not (MISSING_MASS). Check alone: constants stay constant; no ghosts
// of hard edges from 64 taps on.
#define WEIGHT vec3
#include "scatter.glsl"
uniform sampler2D taps;          // row 0: RGB weight, radius mm; row 1: cosine, sine of the angle,
                                 // and the way in px from the pixel's centre where the tap begins
uniform int tap_count;
uniform vec3 centre_weight;      // RGB, of the pixel itself: the profile's energy within it
uniform sampler2D profile;       // ln R(r) over u = sqrt(r / reach)
uniform float profile_reach_mm;
uniform float least_cosine;      // of the plane's normal to the eye
uniform float turn;              // of the whole disk, radians: each supersample has its own taps

vec3 log_profile(float r_mm) {
    float texels = float(textureSize(profile, 0).x);
    float u = sqrt(min(r_mm / profile_reach_mm, 1.0));
    return texture(profile, vec2((u * (texels - 1.0) + 0.5) / texels, 0.5)).rgb;
}

// View ray of a pixel (z = -1, from the eye; along -z if orthographic), and its unit way.
vec3 way_of(vec2 pixel) {
    return is_orthographic ? vec3(0.0, 0.0, -1.0) : vec3(pixel * ray.xy + ray.zw, -1.0);
}

vec2 pixel_of(vec3 point) {
    vec2 xy = is_orthographic ? point.xy : point.xy / max(-point.z, 1e-6);
    return (xy - ray.zw) / ray.xy;
}

void main() {
    if (!begin()) return;
    vec3 eye = -normalize(centre_ray);
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;
    float facing = dot(n, eye);
    if (facing < least_cosine) {
        vec3 side = n - facing * eye;
        float across = length(side);
        side = across > 1e-6 ? side / across : vec3(0.0);
        n = least_cosine * eye + sqrt(1.0 - least_cosine * least_cosine) * side;
        n = normalize(n);
    }
    vec3 t = normalize(abs(n.z) < 0.9 ? cross(n, vec3(0, 0, 1)) : cross(n, vec3(1, 0, 0)));
    vec3 b = cross(n, t);
    float factor = max(width_factor(), 1e-4);
    float angle_0 = turn + 6.2831853 * noise();
    vec2 turned = vec2(cos(angle_0), sin(angle_0));
    add(centre_weight, centre, vec3(1.0), 1.0);
    for (int i = 0; i < tap_count; ++i) {
        vec4 tap = texelFetch(taps, ivec2(i, 0), 0);
        vec4 place = texelFetch(taps, ivec2(i, 1), 0);
        vec2 angle = place.xy;
        angle = vec2(angle.x * turned.x - angle.y * turned.y, angle.x * turned.y + angle.y * turned.x);
        float r2 = tap.a * factor;
        vec3 on_plane = centre_point + r2 * (angle.x * t + angle.y * b);
        vec2 at = clamp(pixel_of(on_plane) + place.zw, -FARTHEST_PX, FARTHEST_PX);
        ivec2 texel = inside(ivec2(floor(at)));
        float z = texelFetch(depth_mm, texel, 0).r;
        vec4 light = texelFetch(source, texel, 0);
        vec3 ratio = vec3(0.0);
        if (z > 0.0) {
            // The plane where this pixel's own ray meets it: what lies beyond is off the plane.
            vec3 w = way_of(vec2(texel) + 0.5);
            vec3 from = is_orthographic ? view_point(vec2(texel) + 0.5, 0.0) : vec3(0.0);
            float plane_z = dot(n, centre_point - from) / min(dot(n, w), -1e-4);
            vec3 space = on_plane + (z - plane_z) * w - centre_point;
            float r3 = max(length(space), r2) / factor;
            vec3 n_q = texelFetch(normal_geometry, texel, 0).xyz;
            vec3 u = normalize(w);
            float area = abs(dot(n, u)) / max(abs(dot(n_q, u)), 0.05);
            if (!is_orthographic) area *= (z * z) / max(plane_z * plane_z, 1e-12);
            ratio = exp(log_profile(r3) - log_profile(tap.a)) * min(area, 20.0);
        }
        add(tap.rgb, light, ratio, guide(texel));
    }
    finish();
}
