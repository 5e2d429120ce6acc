#version 330 core
// diffusion_input: irradiance, albedo, skin, jacobian -> diffusion_input (RGB, a = mask).
// What diffuses is irradiance x albedo^m (d'Eon & Luebke: m = 1 pre, 1/2 mixed, 0 post texturing).
// RGB is premultiplied by the mask = skin x jacobian, so that the normalized filters that follow are
// means over skin *area*: sum k J I / sum k J (halo: measure), exact where the mask ends and under
// linear filtering, at no cost per tap. Dumped, the buffer is divided by the mask again. Check alone: diffusion_input equals irradiance for texturing: post.
uniform sampler2D irradiance;
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D jacobian;
uniform float albedo_power;
uniform bool use_skin;
uniform bool use_jacobian;

layout(location = 0) out vec4 diffusion_input;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 a = texelFetch(albedo, here, 0);
    diffusion_input = vec4(0.0);
    if (a.a == 0.0) return;
    vec3 light = texelFetch(irradiance, here, 0).rgb;
    if (albedo_power > 0.0) light *= pow(a.rgb, vec3(albedo_power));
    float mask = use_skin ? texelFetch(skin, here, 0).r : 1.0;
    // Never quite zero: a pixel whose own mask is 0 must still divide by something positive.
    mask = max(mask, 1e-4);
    if (use_jacobian) mask *= texelFetch(jacobian, here, 0).r;
    diffusion_input = vec4(light * mask, mask);
}
