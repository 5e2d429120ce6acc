#version 330 core
// kernel_px: position -> kernel_px (RGB, px): radius that holds 99.9 % of the profile on screen.
#include "screen.glsl"
uniform sampler2D position;
uniform vec3 radius_mm;
layout(location = 0) out vec4 kernel_px;

void main() {
    vec4 p = texelFetch(position, ivec2(gl_FragCoord.xy), 0);
    kernel_px = p.a == 0.0 ? vec4(0.0) : vec4(radius_mm * px_per_mm(-p.z), 1.0);
}
