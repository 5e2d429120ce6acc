#version 330 core
// The prepared mesh, into view space and onto the picture.
in vec3 position_mm;  // object space, mm
in vec3 normal;       // object space, unit, geometry normal
in vec4 tangent;      // object space, w = sign of the bitangent (MikkTSpace)
in vec2 uv;           // glTF: origin at the first texel row

uniform mat4 view_from_object;
uniform mat4 clip_from_view;

out vec3 v_position;
out vec3 v_normal;
out vec4 v_tangent;
out vec2 v_uv;

void main() {
    vec4 view = view_from_object * vec4(position_mm, 1.0);
    mat3 turn = mat3(view_from_object);  // a rotation: lengths and angles stay
    v_position = view.xyz;
    v_normal = turn * normal;
    v_tangent = vec4(turn * tangent.xyz, tangent.w);
    v_uv = uv;
    gl_Position = clip_from_view * view;
}
