#version 330 core
// curvature: one step of the smoothing, source -> curvature (R32F, 1/mm).
// Cross bilateral Gaussian of `sigma_mm` on the surface: a tap across a depth step does not count.
// FINE takes a tap on every pixel of a narrow Gaussian. COARSE takes the rest of the variance with
// taps a stride apart, which may skip pixels only because FINE has left nothing that fine: taps
// further apart than the noise is coarse made a grid (decision 15). A stride of 1.5 sigmas would do on
// an open surface, but where depth steps cut the taps of a hollow short, it left stripes.
// Check alone: nose tip and lips positive, sockets negative, smooth; no grid at any `sigma_mm`.
#include "screen.glsl"
uniform sampler2D source;
uniform sampler2D position;
uniform vec2 direction;
uniform float sigma_mm;

layout(location = 0) out float smoothed;

const float STRIDE = 0.75;    // of the coarse taps, in sigmas of the fine Gaussian
const float DENSE_PX = 8.0;   // up to here the fine step does it all with fewer taps than two
const float REACH = 3.0;      // sigmas
const int MAX_TAPS = 64;      // to each side; sigmas beyond 340 px lose their tails

// Sigmas in px of the fine and the coarse step: variances add, and sqrt balances their taps.
vec2 steps_px(float sigma_px) {
    float fine = sigma_px <= DENSE_PX ? sigma_px : max(sqrt(sigma_px / STRIDE), 1.5);
    return vec2(fine, sqrt(max(sigma_px * sigma_px - fine * fine, 0.0)));
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 last = textureSize(position, 0) - 1;
    vec4 p = texelFetch(position, here, 0);
    smoothed = 0.0;
    if (p.a == 0.0) return;
    vec2 sigmas = steps_px(sigma_mm * px_per_mm(-p.z));
#ifdef COARSE
    float sigma = sigmas.y;
    float stride = max(floor(STRIDE * sigmas.x), 1.0);
#else
    float sigma = sigmas.x;
    float stride = 1.0;
#endif
    float centre = texelFetch(source, here, 0).r;
    int side = int(min(ceil(REACH * sigma / stride), float(MAX_TAPS)));
    float sum = centre;
    float total = 1.0;
    for (int i = -side; i <= side; ++i) {
        float offset = float(i) * stride;
        ivec2 at = here + ivec2(direction * offset);
        if (i == 0 || any(lessThan(at, ivec2(0))) || any(greaterThan(at, last))) continue;
        vec4 q = texelFetch(position, at, 0);
        float dz = q.z - p.z;
        // By the distance in space: across a silhouette nothing counts, on a slope the radius is the same.
        float w = q.a * exp(-0.5 * offset * offset / max(sigma * sigma, 1e-12)
                            - dz * dz / max(2.0 * sigma_mm * sigma_mm, 1e-12));
        sum += w * texelFetch(source, at, 0).r;
        total += w;
    }
    smoothed = sum / total;
}
