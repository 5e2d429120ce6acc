#version 330 core
// The mesh as one light sees it.
in vec3 position_mm;  // object space, mm

uniform mat4 light_from_object;
uniform mat4 clip_from_light;
uniform float light_front_mm;  // from the subject's centre to the near plane

out float v_depth_mm;      // from the light's near plane along its axis
out float v_from_lamp_mm;  // a lamp's own depth

void main() {
    vec4 in_light = light_from_object * vec4(position_mm, 1.0);
    v_depth_mm = light_front_mm - in_light.z;
    gl_Position = clip_from_light * in_light;
    v_from_lamp_mm = gl_Position.w;
}
