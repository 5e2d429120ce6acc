#version 330 core
// contrast: radiance of the pixels' centres -> depth 1 where further samples would show, 0 elsewhere.
// A pixel shows them where it and its neighbours differ in the root of a
// channel's light, which grows as lightness does: its mean can then be off by part of that.
uniform sampler2D radiance;
uniform vec3 background;
uniform float exposure;      // 2^EV
uniform float threshold;     // of the root of light on the screen
uniform int guard_px;        // the band around the picture, which nobody sees

vec3 seen(ivec2 at) {
    vec4 light = texelFetch(radiance, clamp(at, ivec2(0), textureSize(radiance, 0) - 1), 0);
    return sqrt(clamp((light.rgb + (1.0 - light.a) * background) * exposure, 0.0, 1.0));
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 inside = min(here - guard_px, textureSize(radiance, 0) - 1 - guard_px - here);
    gl_FragDepth = 0.0;
    if (min(inside.x, inside.y) < 0) return;
    vec3 low = vec3(1e9), high = vec3(-1e9);
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            vec3 there = seen(here + ivec2(x, y));
            low = min(low, there);
            high = max(high, there);
        }
    }
    vec3 range = high - low;
    gl_FragDepth = max(range.r, max(range.g, range.b)) > threshold ? 1.0 : 0.0;
}
