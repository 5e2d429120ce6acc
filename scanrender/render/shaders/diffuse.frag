#version 330 core
// diffuse: light that leaves the skin after scattering and albedo.
//   diffuse = (1 - rho_dt(N.V)) albedo^(1-m) [ s scattered + (1-s) diffusion_input ]
// s = skin, so that what is no skin keeps its own, unscattered light.
// Check alone: soft skin; brows, lashes and eyes as sharp as the albedo.
#include "screen.glsl"
uniform sampler2D scattered;       // both RGB premultiplied, a = mask
uniform sampler2D diffusion_input;
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D directional_albedo;
uniform float albedo_power;        // m

layout(location = 0) out vec4 diffuse;

vec3 unmasked(sampler2D light, ivec2 here) {
    vec4 masked = texelFetch(light, here, 0);
    return masked.rgb / max(masked.a, 1e-8);
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 a = texelFetch(albedo, here, 0);
    diffuse = vec4(0.0);
    if (a.a == 0.0) return;
#if defined(SCATTERED) && defined(UNSCATTERED)
    vec3 light = mix(unmasked(diffusion_input, here), unmasked(scattered, here),
                     texelFetch(skin, here, 0).r);
#elif defined(SCATTERED)
    vec3 light = unmasked(scattered, here);
#else
    vec3 light = unmasked(diffusion_input, here);
#endif
    vec3 v = direction_to_eye(texelFetch(position, here, 0).xyz);
    float cosine = clamp(dot(texelFetch(normal_shading, here, 0).xyz, v), 0.0, 1.0);
    float leaves = 1.0 - texture(directional_albedo, vec2(cosine, 0.5)).r;
    vec3 tint = albedo_power < 1.0 ? pow(a.rgb, vec3(1.0 - albedo_power)) : vec3(1.0);
    diffuse = vec4(tint * light * leaves, 0.0);
}
