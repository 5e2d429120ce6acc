#version 330 core
// scattered: sum_k w_k gaussian_k, diffusion_input -> scattered (RGB premultiplied, a = the mask of
// diffusion_input). Up to eight levels a draw, more are added by further draws.
// Check alone: a plaster cast gone soft.
uniform sampler2D diffusion_input; // a = mask
uniform sampler2D level_0;         // RGB premultiplied, a = mask, blurred along with the light
uniform sampler2D level_1;
uniform sampler2D level_2;
uniform sampler2D level_3;
uniform sampler2D level_4;
uniform sampler2D level_5;
uniform sampler2D level_6;
uniform sampler2D level_7;
uniform vec4 weight[8];            // RGB w_k
uniform int level_count;
uniform bool brings_mask;          // the first draw does

layout(location = 0) out vec4 scattered;

vec3 term(sampler2D level, int k, ivec2 here) {
    vec4 masked = texelFetch(level, here, 0);
    return k < level_count ? weight[k].rgb * (masked.rgb / max(masked.a, 1e-12)) : vec3(0.0);
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    float mask = texelFetch(diffusion_input, here, 0).a;
    scattered = vec4(0.0);
    if (mask == 0.0) return;
    vec3 sum = term(level_0, 0, here) + term(level_1, 1, here) + term(level_2, 2, here)
             + term(level_3, 3, here) + term(level_4, 4, here) + term(level_5, 5, here)
             + term(level_6, 6, here) + term(level_7, 7, here);
    scattered = vec4(sum * mask, brings_mask ? mask : 0.0);
}
