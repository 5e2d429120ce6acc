#version 330 core
// gaussian_sum: one direction of one Gaussian of the profile.
//   source (diffusion_input or gaussian_{k-1}) + depth_mm -> gaussian_k (RGB premultiplied, a mask)
// Progressive: G(v1) * G(v2) = G(v1 + v2), so level k blurs level k-1 by v_k - v_{k-1}
// (d'Eon & Luebke 2007; Jimenez & Gutierrez 2010 in screen space).
// Radius on screen: px = mm 0.5 H P11 / z (screen.glsl): independent of distance, field of view, aspect and
// resolution. Below 0.7 px the three-tap kernel [v/2, 1-v, v/2] has exactly the variance wanted and
// tends to the identity; above it the bilinear fetch's own variance of 1/6 px^2 is taken off.
// Across a depth step dz a tap counts exp(-dz^2 / 2v), the Gaussian's own third dimension, so there
// is no scale constant. halo = depth: Jimenez' correction, what is lost goes to the centre.
// halo = measure: it is lost to the normalization (with diffusion_input's jacobian, a mean over the
// surface: exact on planes tilted about a screen axis; Mikkelsen 2010).
// Check alone: constant irradiance stays constant; gaussian_k is softer than gaussian_{k-1}.
#include "screen.glsl"
uniform sampler2D source;
uniform sampler2D depth_mm;      // -z, 0 where there is no surface
uniform vec2 taps[255];          // (offset in sigma, weight); the first tap_count weights sum to 1
uniform int tap_count;
uniform vec2 direction;          // (1,0) or (0,1)
uniform float sigma_mm;          // of this increment
uniform int halo;                // 0 none, 1 depth, 2 measure

layout(location = 0) out vec4 blurred;

ivec2 here = ivec2(gl_FragCoord.xy);
ivec2 last = textureSize(depth_mm, 0) - 1;
vec4 centre;
float centre_z;
float inverse_two_v;

vec4 faded(vec4 tap, ivec2 texel) {
    if (halo == 0) return tap;
    float z = texelFetch(depth_mm, clamp(texel, ivec2(0), last), 0).r;
    // Where nothing was drawn there is no depth; its mask of 0 already keeps it out.
    float dz = z > 0.0 ? z - centre_z : 0.0;
    float near = exp(-dz * dz * inverse_two_v);
    return halo == 1 ? mix(centre, tap, near) : near * tap;
}

void main() {
    centre = texelFetch(source, here, 0);
    centre_z = texelFetch(depth_mm, here, 0).r;
    if (centre_z <= 0.0) { blurred = vec4(0.0); return; }
    inverse_two_v = 0.5 / max(sigma_mm * sigma_mm, 1e-12);
    float sigma_px = sigma_mm * px_per_mm(centre_z);
    float v_px = sigma_px * sigma_px;

    vec4 sum = vec4(0.0);
    if (v_px < 0.5) {
        ivec2 step_px = ivec2(direction);
        for (int side = -1; side <= 1; side += 2) {
            ivec2 texel = clamp(here + side * step_px, ivec2(0), last);
            sum += 0.5 * v_px * faded(texelFetch(source, texel, 0), texel);
        }
        sum += (1.0 - v_px) * centre;
    } else {
        float reach = sqrt(v_px - 1.0 / 6.0);
        vec2 inverse_size = 1.0 / vec2(last + 1);
        for (int i = 0; i < tap_count; ++i) {
            vec2 tap = taps[i];
            vec2 at = gl_FragCoord.xy + direction * (tap.x * reach);
            sum += tap.y * faded(texture(source, at * inverse_size), ivec2(floor(at)));
        }
    }
    // The centre's own range weight is 1: the sum cannot vanish, even with an even number of taps.
    sum += 1e-5 * centre;
    // Normalized by the mask that was met; premultiplied again by the pixel's own.
    blurred = vec4(sum.rgb * (centre.a / max(sum.a, 1e-8)), centre.a);
}
