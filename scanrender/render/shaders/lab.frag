#version 330 core
// lab: albedo -> CIE Lab (D65), smoothed along the surface with its edges kept -> lab (L, a, b).
// CONVERT: albedo, clamped to [0, 1], to Lab. Else one direction of a bilateral Gaussian of `sigma_mm`:
// a tap counts by its distance, depth step and colour difference, so that the noise of a scan's
// texture goes and the border of a lip stays. Of albedo, so that exposure cannot move the limit.
// Check alone: flat patches of colour, borders as sharp as the albedo's.
#include "screen.glsl"
uniform sampler2D source;        // albedo, or Lab
uniform sampler2D depth_mm;
uniform sampler2D taps;          // (offset in sigma, weight)
uniform int tap_count;
uniform vec2 direction;
uniform float sigma_mm;
uniform float colour_falloff;    // 1 / 2s^2, s in dE

layout(location = 0) out vec4 lab;

// CIE 15: cube root, with its straight part near black.
vec3 lab_curve(vec3 t) {
    return mix(t * (841.0 / 108.0) + 4.0 / 29.0, pow(t, vec3(1.0 / 3.0)),
               greaterThan(t, vec3(216.0 / 24389.0)));
}

vec3 lab_from_linear_rec709(vec3 c) {
    // Rows: X, Y, Z over the D65 white.
    vec3 xyz = vec3(dot(c, vec3(0.4124564, 0.3575761, 0.1804375)) / 0.9504559,
                    dot(c, vec3(0.2126729, 0.7151522, 0.0721750)),
                    dot(c, vec3(0.0193339, 0.1191920, 0.9503041)) / 1.0890578);
    vec3 f = lab_curve(max(xyz, 1e-9));
    return vec3(116.0 * f.y - 16.0, 500.0 * (f.x - f.y), 200.0 * (f.y - f.z));
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    lab = vec4(0.0);
    float z = texelFetch(depth_mm, here, 0).r;
    if (z <= 0.0) return;
    vec4 centre = texelFetch(source, here, 0);
#ifdef CONVERT
    lab = vec4(lab_from_linear_rec709(clamp(centre.rgb, 0.0, 1.0)), 1.0);
#else
    ivec2 last = textureSize(source, 0) - 1;
    float sigma_px = sigma_mm * px_per_mm(z);
    float depth_falloff = 0.25 / max(sigma_mm * sigma_mm, 1e-12);
    vec3 sum = 1e-4 * centre.rgb;
    float total = 1e-4;
    for (int i = 0; i < tap_count; ++i) {
        vec2 tap = texelFetch(taps, ivec2(i, 0), 0).xy;
        ivec2 at = clamp(ivec2(floor(gl_FragCoord.xy + direction * tap.x * sigma_px)), ivec2(0), last);
        float dz = texelFetch(depth_mm, at, 0).r - z;
        vec4 q = texelFetch(source, at, 0);
        vec3 d = q.rgb - centre.rgb;
        float w = q.a * tap.y * exp(-dz * dz * depth_falloff - dot(d, d) * colour_falloff);
        sum += w * q.rgb;
        total += w;
    }
    lab = vec4(sum / total, 1.0);
#endif
}
