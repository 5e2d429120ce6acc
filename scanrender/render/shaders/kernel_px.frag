#version 330 core
// kernel_px: position, curvature -> kernel_px (RGB, px): radius that holds 99.9 % of the light.
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D curvature;     // 1/mm, with CURVATURE
uniform vec4 width_by_curvature;
uniform vec3 radius_mm;
layout(location = 0) out vec4 kernel_px;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    kernel_px = vec4(0.0);
    if (p.a == 0.0) return;
    kernel_px = vec4(radius_mm * px_per_mm(-p.z), 1.0);
#ifdef CURVATURE
    float bent = min(max(texelFetch(curvature, here, 0).r, 0.0) * width_by_curvature.z, 1.0);
    kernel_px.rgb *= width_by_curvature.x + width_by_curvature.y * bent;
#endif
}
