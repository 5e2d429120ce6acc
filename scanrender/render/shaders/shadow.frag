#version 330 core
// shadow: mesh -> shadow_N (R32F, mm).
// Linear depth in millimetres, so that thickness and bias are lengths at any distance (DESIGN 6).
// Check alone: shadow_0 is a smooth relief; where the light sees nothing it holds the far value.
#include "linear_depth.glsl"
in float v_depth_mm;
in float v_from_lamp_mm;
layout(location = 0) out float shadow;

void main() {
    shadow = v_depth_mm;
    write_depth(v_from_lamp_mm);
}
