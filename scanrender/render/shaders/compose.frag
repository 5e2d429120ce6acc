#version 330 core
// compose: position, diffuse, specular and transmission -> radiance (RGB, a = coverage).
// Check alone: radiance - diffuse - specular is the glow of the ears, and nothing else.
uniform sampler2D position;
uniform sampler2D diffuse;
uniform sampler2D specular;
uniform sampler2D transmission;
uniform bool has_specular;
uniform bool has_transmission;

layout(location = 0) out vec4 radiance;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    float coverage = texelFetch(position, here, 0).a;
    radiance = vec4(0.0);
    if (coverage == 0.0) return;
    vec3 sum = texelFetch(diffuse, here, 0).rgb;
    if (has_specular) sum += texelFetch(specular, here, 0).rgb;
    if (has_transmission) sum += texelFetch(transmission, here, 0).rgb;
    radiance = vec4(sum, coverage);
}
