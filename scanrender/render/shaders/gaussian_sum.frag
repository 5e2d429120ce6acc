#version 330 core
// gaussian_sum: one direction of one Gaussian of the profile.
//   source (diffusion_input or gaussian_{k-1}) + depth_mm + guides -> gaussian_k (RGB premultiplied)
// Progressive: G(v1) * G(v2) = G(v1 + v2), so level k blurs level k-1 by v_k - v_{k-1}
// (d'Eon & Luebke 2007; Jimenez & Gutierrez 2010 in screen space).
// Radius on screen: px = mm 0.5 H P11 / z: independent of distance, field of view, aspect and
// resolution. Up to narrow_px sigma the taps are whole pixels, with weights from a table of exact
// integrals over pixel footprints, that tends to the identity; wider ones lie between two pixels, and
// the variance of that is taken off.
// Across a depth step a tap counts exp(-dz^2 / 2v), the Gaussian's own third dimension, so there is
// no scale constant. HALO_MEASURE: the distance is that of the 3-D points, and a tilted plane's
// foreshortening narrows the kernel on screen. Check alone: constant irradiance stays constant.
#define WEIGHT float
#define CHAIN
#include "scatter.glsl"
uniform sampler2D table;         // rows: sigma 0 to table_px; columns: taps -radius to radius
uniform int radius;              // px
uniform float table_px;
uniform float narrow_px;         // sigma up to which the table is used
uniform vec2 taps[255];          // (offset in sigma, weight); the first tap_count weights sum to 1
uniform int tap_count;
uniform float tap_cell;          // sigma, how far a tap may move
uniform float sigma_mm;          // of this increment
uniform float bilinear_px2;      // variance taken off a tap between two pixels
uniform float shift_px;          // the sample's place in its pixel, along the direction

void main() {
    if (!begin()) return;
    float sigma = max(sigma_mm * width_factor(), 1e-6);
    float v = sigma * sigma;
    float v_px = v / (mm_per_px * mm_per_px);
    float stretch = 1.0;
#ifdef HALO_MEASURE
    stretch = stretch2();
#endif
    float sigma_px = sqrt(v_px / stretch);
    // Far off the axis of a wide lens a surface is nearer than it is deep: stretch < 1, and what is
    // wide on screen may be no pixel wide facing. The taps below would then ask for less than no variance.
    if (min(sigma_px, sqrt(v_px)) <= narrow_px) {
        sigma_px = min(sigma_px, narrow_px);
        float step_mm2 = mm_per_px * mm_per_px * stretch;
        // A pixel is no point: its own variance counts with the Gaussian's.
        float falloff = 0.5 / (v + step_mm2 / 6.0);
        vec2 size = vec2(textureSize(table, 0));
        float row = (sigma_px / table_px * (size.y - 1.0) + 0.5) / size.y;
        for (int j = -radius; j <= radius; ++j) {
            float k = textureLod(table, vec2((float(j + radius) + 0.5) / size.x, row), 0.0).r;
            add_at(k, j, step_mm2, falloff);
        }
    } else {
        float reach = sqrt(v_px - bilinear_px2);
        float moved = 2.0 * noise() * tap_cell;
        for (int i = 0; i < tap_count; ++i)
            add_between(taps[i].y, (taps[i].x + moved) * reach - shift_px, mm_per_px * mm_per_px, 0.5 / v);
    }
    finish();
}
