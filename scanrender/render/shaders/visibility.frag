#version 330 core
// visibility: position, normal_geometry, shadow_N -> visibility_N (R32F, 0 dark to 1 lit).
// Percentage-closer filtering over a disk of `blur_mm`, with the receiver's own plane as the depth
// to compare with, so that a wide filter does not darken a lit slope.
// Check alone: visibility_0 is a clean stencil of the lit side, without stripes (acne).
#include "common.glsl"
#include "shadow_lookup.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform float blur_mm;      // mm, radius of the soft edge
uniform float texel_mm;     // mm, one shadow map texel at the subject's centre
uniform vec3 to_light;      // view, unit (subject centre -> light)
uniform int taps;
uniform float turn;         // radians, differs per supersample so that their average is finer

layout(location = 0) out float visibility;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    if (p.a == 0.0) { visibility = 0.0; return; }
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;

    // Turned well away: no light to ask for. Normal maps may turn a pixel back by less than this.
    if (dot(n, to_light) < -0.5) { visibility = 0.0; return; }

    // Leave the surface by 1.5 texels: what the map cannot resolve must not shadow itself.
    LightPoint lit = light_point(p.xyz + n * 1.5 * texel_mm);
    vec2 slope = plane_slope(n);
    float radius_mm = max(blur_mm, texel_mm);

    float sum = 0.0;
    for (int i = 0; i < taps; ++i) {
        vec2 offset_mm = disk_point(i, taps, turn) * radius_mm;
        float blocker = texture(shadow_map, lit.uv + offset_mm / lit.mm_per_uv).r;
        float receiver = lit.depth_mm + dot(slope, offset_mm) - 0.5 * texel_mm;
        sum += blocker < receiver ? 0.0 : 1.0;
    }
    visibility = sum / float(taps);
}
