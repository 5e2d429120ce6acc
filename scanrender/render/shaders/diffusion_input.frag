#version 330 core
// diffusion_input: irradiance, albedo, skin, jacobian, depth_mm -> diffusion_input (RGB, a = mask).
// What diffuses is irradiance x albedo^m (d'Eon & Luebke: m = 1 pre, 1/2 mixed, 0 post texturing).
// RGB is premultiplied by the mask = skin x jacobian / depth, so that the normalized filters that
// follow are means over skin *surface*: sum k m I / sum k m (halo: measure), exact where the mask ends
// and under linear filtering, at no cost per tap. Each of the two passes sums along a line, whose
// measure is area / width of a row, and a row is as wide as its depth: hence jacobian / depth. With the
// jacobian alone a plane seen at 60 deg through a 90 deg lens is 2 % off. Dumped, the buffer is divided
// by the mask again. Check alone: diffusion_input equals irradiance for texturing: post.
#include "screen.glsl"
uniform sampler2D irradiance;
uniform sampler2D albedo;
uniform sampler2D skin;
uniform sampler2D jacobian;
uniform sampler2D depth_mm;
uniform float working_distance_mm;
uniform float farthest_mm;    // of the subject
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
    if (use_jacobian) {
        float row = px_per_mm(texelFetch(depth_mm, here, 0).r) / px_per_mm(working_distance_mm);
        // Any unit of area would do: in that of the farthest pixel no mask is beyond half floats.
        float unit = px_per_mm(farthest_mm) / px_per_mm(working_distance_mm);
        mask *= texelFetch(jacobian, here, 0).r * row * unit;
    }
    diffusion_input = vec4(light * mask, mask);
}
