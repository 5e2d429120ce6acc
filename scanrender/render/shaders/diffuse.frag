#version 330 core
// diffuse: one Gaussian level's share of the light that leaves the skin, after albedo.
//   diffuse = (1 - rho_dt(N.V)) albedo^(1-m) [ s sum_k w_k gaussian_k + (1-s) diffusion_input ]
// Run once per level with additive blending; s = skin, so that what is no skin keeps its own light.
// Check alone: soft skin; brows, lashes and eyes as sharp as the albedo.
uniform sampler2D level;           // premultiplied, a = mask
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D directional_albedo;
uniform vec3 weight;               // w_k, or 1 for the undiffused rest
uniform float albedo_power;        // m
uniform int blend;                 // 0: no mask, 1: share s, 2: share 1 - s

layout(location = 0) out vec4 diffuse;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 a = texelFetch(albedo, here, 0);
    diffuse = vec4(0.0);
    if (a.a == 0.0) return;
    vec4 light = texelFetch(level, here, 0);
    float s = texelFetch(skin, here, 0).r;
    float share = blend == 0 ? 1.0 : (blend == 1 ? s : 1.0 - s);
    vec3 v = -normalize(texelFetch(position, here, 0).xyz);
    float cosine = clamp(dot(texelFetch(normal_shading, here, 0).xyz, v), 0.0, 1.0);
    float leaves = 1.0 - texture(directional_albedo, vec2(cosine, 0.5)).r;
    vec3 tint = albedo_power < 1.0 ? pow(a.rgb, vec3(1.0 - albedo_power)) : vec3(1.0);
    diffuse = vec4(weight * tint * light.rgb * (share * leaves / max(light.a, 1e-8)), 0.0);
}
