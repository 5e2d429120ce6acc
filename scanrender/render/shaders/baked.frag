#version 330 core
// baked: mesh + data maps -> _baked (r: mean curvature 1/mm; g: thickness mm; a = coverage).
// Seen through the same camera as gbuffer, for the settings that take these from the asset rather than
// from the picture. Check alone: `curvature` with source: baked has no lines along silhouettes.
#include "footprint.glsl"
#include "linear_depth.glsl"
in vec3 v_position;
in vec2 v_uv;
uniform sampler2D curvature_map;
uniform sampler2D thickness_map;

layout(location = 0) out vec4 baked;

void main() {
    float curvature = map_at(curvature_map, v_uv, 0.0).r;
    float thickness_mm = max(map_at(thickness_map, v_uv, 0.0).r, 0.0);
    baked = vec4(curvature, thickness_mm, 0.0, 1.0);
    write_depth(-v_position.z);
}
