#version 330 core
// reproject: scattered and position of the pixels' centres (or of a smaller picture), position of
// this sample -> scattered.
// A mean over the 3 x 3 centres around, by a tent and by nearness on the surface: across a
// silhouette they lie millimetres apart, and count next to nothing.
// Check alone: equals scattered inside a surface; no rim of the background's or neighbour's light.
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D diffusion_input;   // what a surface keeps that no centre has seen
uniform sampler2D centre_scattered;  // RGB premultiplied, a = mask
uniform sampler2D centre_position;
uniform vec2 moved_px;               // this sample from the centre, GL's axes
uniform float scale;                 // pixels of the centres' picture per pixel
uniform vec2 size_px;                // of this picture; both have their middle in common

layout(location = 0) out vec4 scattered;

const float NEAR_PX = 3.0;           // a slanted face's next centre may be this far on it

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    scattered = vec4(0.0);
    if (p.a == 0.0) return;
    float px = px_per_mm(-p.z) * scale;
    ivec2 last = textureSize(centre_position, 0) - 1;
    vec2 at = (gl_FragCoord.xy + moved_px - 0.5 * size_px) * scale + 0.5 * vec2(last);
    ivec2 nearest = ivec2(floor(at + 0.5));
    vec4 sum = vec4(0.0);
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            ivec2 there = clamp(nearest + ivec2(x, y), ivec2(0), last);
            vec4 q = texelFetch(centre_position, there, 0);
            vec3 apart = (q.xyz - p.xyz) * px;
            vec2 tent = max(1.0 - abs(vec2(nearest + ivec2(x, y)) - at), 0.03);
            float far = dot(apart, apart) / (NEAR_PX * NEAR_PX);
            float share = q.a * tent.x * tent.y / (1.0 + far * far);
            sum += share * texelFetch(centre_scattered, there, 0);
        }
    }
    vec4 own = texelFetch(diffusion_input, here, 0);
    scattered = sum.a > 1e-12 ? vec4(sum.rgb / sum.a, 1.0) : own;
}
