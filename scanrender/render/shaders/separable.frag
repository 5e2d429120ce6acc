#version 330 core
// separable: one direction of a separable kernel (Jimenez et al. 2015).
//   diffusion_input + depth_mm + guides -> diffuse_horizontal, then that -> scattered (premultiplied)
// The kernel is a(x) a(y), a per channel: the profile's line integral, or two Gaussians. Exact for
// straight edges along x or y, but a picture of a round profile by rank 1: 28 % of red's energy lands
// in the wrong place, in a cross. A finding, not a bug.
// Tap weights are exact integrals over cells; shared between two pixels they make the
// pixel's footprint. Offsets are mm, px = mm 0.5 H P11 / z. Across a depth step a tap counts
// a(sqrt(x^2 + dz^2)) / a(x), to first order in dz^2. Check alone: constants stay constant.
#define WEIGHT vec3
#include "scatter.glsl"
layout(std140) uniform Taps {
    vec4 weight_offset[255];     // RGB weight, each summing to 1; a: offset, mm
    vec4 falloff_cell[255];      // RGB 1/mm^2; a: how far the tap may move, mm
};
uniform int tap_count;

void main() {
    if (!begin()) return;
    float factor = max(width_factor(), 1e-4);
    float stretch = 1.0;
#ifdef HALO_MEASURE
    // Along the surface, not the screen: right for any kernel on a plane. No further than 60 deg,
    // beyond which a face is no plane within the kernel's reach.
    stretch = min(stretch2(), 4.0);
#endif
    float step_mm2 = mm_per_px * mm_per_px * stretch;
    float px_per_mm = factor * inversesqrt(step_mm2);
    float narrower = 1.0 / (factor * factor);
    float moved = 2.0 * noise();
    // A pixel is no point: its own variance counts with the kernel's.
    float pixel_mm2 = step_mm2 / 6.0;
    for (int i = 0; i < tap_count; ++i) {
        vec4 tap = weight_offset[i];
        vec4 side = falloff_cell[i];
        vec3 q = side.rgb * narrower;
        float offset_px = (tap.a + moved * side.a) * px_per_mm;
        add_between(tap.rgb, offset_px, step_mm2, q / (1.0 + 2.0 * q * pixel_mm2));
    }
    finish();
}
