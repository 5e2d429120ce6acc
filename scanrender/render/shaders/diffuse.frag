#version 330 core
// diffuse: light that leaves the skin after scattering and albedo; the levels' weighted sum.
//   diffuse = (1 - rho_dt(N.V)) albedo^(1-m) [ s sum_k w_k gaussian_k + (1-s) diffusion_input ]
// s = skin, so that what is no skin keeps its own, unscattered light. Up to eight levels a draw,
// more are added by further draws.
// Check alone: soft skin; brows, lashes and eyes as sharp as the albedo.
#include "screen.glsl"
uniform sampler2D level_0;         // RGB premultiplied, a = mask
uniform sampler2D level_1;
uniform sampler2D level_2;
uniform sampler2D level_3;
uniform sampler2D level_4;
uniform sampler2D level_5;
uniform sampler2D level_6;
uniform sampler2D level_7;
uniform vec4 weight[8];            // RGB w_k (1 for the undiffused rest); a: 0 no mask, 1 s, 2 1-s
uniform int level_count;
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D directional_albedo;
uniform float albedo_power;        // m

layout(location = 0) out vec4 diffuse;

float s;

vec3 term(sampler2D level, int k, ivec2 here) {
    if (k >= level_count) return vec3(0.0);
    vec4 light = texelFetch(level, here, 0);
    float share = weight[k].a == 0.0 ? 1.0 : (weight[k].a == 1.0 ? s : 1.0 - s);
    return weight[k].rgb * light.rgb * (share / max(light.a, 1e-8));
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 a = texelFetch(albedo, here, 0);
    diffuse = vec4(0.0);
    if (a.a == 0.0) return;
    s = texelFetch(skin, here, 0).r;
    vec3 sum = term(level_0, 0, here) + term(level_1, 1, here) + term(level_2, 2, here)
             + term(level_3, 3, here) + term(level_4, 4, here) + term(level_5, 5, here)
             + term(level_6, 6, here) + term(level_7, 7, here);
    vec3 v = direction_to_eye(texelFetch(position, here, 0).xyz);
    float cosine = clamp(dot(texelFetch(normal_shading, here, 0).xyz, v), 0.0, 1.0);
    float leaves = 1.0 - texture(directional_albedo, vec2(cosine, 0.5)).r;
    vec3 tint = albedo_power < 1.0 ? pow(a.rgb, vec3(1.0 - albedo_power)) : vec3(1.0);
    diffuse = vec4(tint * sum * leaves, 0.0);
}
