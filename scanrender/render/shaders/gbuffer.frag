#version 330 core
// gbuffer: mesh + maps -> position (view, mm; a = coverage), normal_geometry, normal_shading
// (view, unit), albedo (lin_rec709_scene; a = 1), depth_mm, skin, ao.
// Check alone: normal_geometry must show no pores, normal_shading must.
#include "footprint.glsl"
#include "linear_depth.glsl"
#include "screen.glsl"
in vec3 v_position;
in vec3 v_normal;
in vec4 v_tangent;
in vec2 v_uv;

uniform sampler2D albedo_map;
uniform sampler2D normal_map;  // tangent space unit vector, +Y
uniform sampler2D ao_map;
uniform sampler2D skin_map;
uniform vec3 inside_albedo;    // of the back of the surface, lin_rec709_scene
uniform float lod_bias;

layout(location = 0) out vec4 position;
layout(location = 1) out vec4 normal_geometry;
layout(location = 2) out vec4 normal_shading;
layout(location = 3) out vec4 albedo;
layout(location = 4) out float depth_mm;
layout(location = 5) out float skin;
layout(location = 6) out float ao;

// A scan's normals can vanish between opposed vertices; fall back rather than divide by zero.
vec3 safe_unit(vec3 v, vec3 otherwise) {
    float squared = dot(v, v);
    return squared > 1e-12 ? v * inversesqrt(squared) : otherwise;
}

void main() {
    // The triangle's own normal, toward the eye: what there is where the vertices have none.
    vec3 to_eye = direction_to_eye(v_position);
    vec3 face = cross(dFdx(v_position), dFdy(v_position));
    float area = length(face);
    face = area > 0.0 ? face / area : to_eye;
    face *= dot(face, to_eye) < 0.0 ? -1.0 : 1.0;
    vec3 n = safe_unit(v_normal, gl_FrontFacing ? face : -face);
    // An open back or a hole shows the inside of the surface. It is lit from the side that is seen,
    // and drawn as no skin at all: the hollow of a face, textured, reads as a second face.
    if (!gl_FrontFacing) n = -n;

    // MikkTSpace: the interpolated tangent and sign are used as they are, not re-orthogonalised.
    vec3 bitangent = v_tangent.w * cross(v_normal, v_tangent.xyz);
    vec3 t = map_at(normal_map, v_uv, lod_bias).xyz;
    vec3 shading = safe_unit(t.x * v_tangent.xyz + t.y * bitangent + t.z * v_normal, n);
    if (!gl_FrontFacing) shading = n;

    position = vec4(v_position, 1.0);
    normal_geometry = vec4(n, 1.0);
    normal_shading = vec4(shading, 1.0);
    albedo = vec4(clamp(map_at(albedo_map, v_uv, lod_bias).rgb, 0.0, 1.0), 1.0);
    skin = clamp(map_at(skin_map, v_uv, lod_bias).r, 0.0, 1.0);
    ao = clamp(map_at(ao_map, v_uv, lod_bias).r, 0.0, 1.0);
    depth_mm = -v_position.z;
    write_depth(depth_mm);
    if (!gl_FrontFacing) {
        albedo.rgb = inside_albedo;
        skin = 0.0;
    }
}
