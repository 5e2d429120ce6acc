#version 330 core
// energy_ratio: scattered over diffusion_input, per channel.
// 1 where light stays, above 1 where it arrives (inside shadow edges), below 1 where it leaves.
uniform sampler2D scattered;
uniform sampler2D diffusion_input;
uniform float least_light;   // units of pi: a share of the scene's light, so that the ratio has no unit
layout(location = 0) out vec4 energy_ratio;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 undiffused = texelFetch(diffusion_input, here, 0);
    energy_ratio = vec4(0.0);
    if (undiffused.a == 0.0) return;
    // A shadow's core has no light of its own: the floor keeps the ratio finite there.
    vec3 floor_value = vec3(max(least_light, 1e-30) * undiffused.a);
    vec3 ratio = texelFetch(scattered, here, 0).rgb / max(undiffused.rgb, floor_value);
    energy_ratio = vec4(ratio, 0.0);
}
