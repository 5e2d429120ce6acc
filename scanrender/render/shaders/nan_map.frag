#version 330 core
// nan_map: radiance -> nan_map (R32F): 1 where a channel is NaN, infinite or negative.
uniform sampler2D radiance;
layout(location = 0) out float nan_map;

void main() {
    vec4 r = texelFetch(radiance, ivec2(gl_FragCoord.xy), 0);
    bool bad = any(isnan(r)) || any(isinf(r)) || any(lessThan(r, vec4(0.0)));
    nan_map = bad ? 1.0 : 0.0;
}
