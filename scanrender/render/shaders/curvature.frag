#version 330 core
// curvature: one direction of the smoothing, curvature_raw -> curvature (R32F, 1/mm).
// Cross bilateral Gaussian of `sigma_mm` on the surface: a tap across a depth step does not count.
// Check alone: nose tip and lips positive, sockets negative, smooth.
#include "screen.glsl"
uniform sampler2D source;
uniform sampler2D position;
uniform sampler2D taps;
uniform int tap_count;
uniform vec2 direction;
uniform float sigma_mm;

layout(location = 0) out float smoothed;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 last = textureSize(position, 0) - 1;
    vec4 p = texelFetch(position, here, 0);
    smoothed = 0.0;
    if (p.a == 0.0) return;
    float sigma_px = sigma_mm * px_per_mm(-p.z);
    float sum = 0.0;
    float total = 0.0;
    for (int i = 0; i < tap_count; ++i) {
        vec2 tap = texelFetch(taps, ivec2(i, 0), 0).xy;
        ivec2 at = clamp(ivec2(floor(gl_FragCoord.xy + direction * tap.x * sigma_px)), ivec2(0), last);
        vec4 q = texelFetch(position, at, 0);
        float dz = q.z - p.z;
        // Twice the variance: a slope of 45 degrees still counts, a silhouette does not.
        float w = q.a * tap.y * exp(-dz * dz / max(4.0 * sigma_mm * sigma_mm, 1e-12));
        sum += w * texelFetch(source, at, 0).r;
        total += w;
    }
    smoothed = total > 0.0 ? sum / total : texelFetch(source, here, 0).r;
}
