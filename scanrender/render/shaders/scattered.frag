#version 330 core
// scattered: sum_k w_k gaussian_k -> scattered (RGB premultiplied, a = mask), added level by level.
// For whoever asks for it: the picture itself adds the levels in `diffuse`.
uniform sampler2D level;
uniform vec3 weight;
uniform float first;             // 1 for the level that brings the mask
layout(location = 0) out vec4 scattered;

void main() {
    vec4 light = texelFetch(level, ivec2(gl_FragCoord.xy), 0);
    scattered = vec4(weight * light.rgb, first * light.a);
}
