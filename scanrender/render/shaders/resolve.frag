#version 330 core
// resolve: radiance of one sample -> beauty, weighted and added (RGB premultiplied by coverage).
uniform sampler2D radiance;
uniform float weight;  // 1 / samples
layout(location = 0) out vec4 beauty;

void main() { beauty = weight * texelFetch(radiance, ivec2(gl_FragCoord.xy), 0); }
