#version 330 core
// specular: position, normal_shading, ao, visibility_N -> specular (RGB radiance, added over lamps).
// Kelemen & Szirmay-Kalos 2001: f = D_Beckmann(N.H, m) F(H.V) / (h.h), h = L + V un-normalised.
// D carries the 1/pi that GPU Gems 3 drops; irradiance in units of pi cancels it here.
// Never blurred. Ambient: directional albedo times the constant light, dimmed by ao.
// Check alone: highlights as sharp as the normal map; none in shadow.
#include "common.glsl"
#include "light.glsl"
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D ao;
uniform sampler2D visibility;
uniform sampler2D directional_albedo;
uniform bool is_ambient;
uniform bool has_shadow;
uniform vec3 ambient;
uniform float f0;
uniform vec2 roughness;      // Beckmann m of each lobe
uniform float second_lobe;   // share of the second
uniform float strength;

layout(location = 0) out vec4 specular;

// Beckmann & Spizzichino 1963, times pi: exp(-tan^2 / m^2) / (m^2 cos^4).
float beckmann_pi(float cosine, float m) {
    float c2 = max(cosine * cosine, 1e-4);
    float m2 = m * m;
    return exp((c2 - 1.0) / (c2 * m2)) / (m2 * c2 * c2);
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    specular = vec4(0.0);
    if (p.a == 0.0) return;
    vec3 n = texelFetch(normal_shading, here, 0).xyz;
    vec3 v = direction_to_eye(p.xyz);
    if (is_ambient) {
        float cosine = clamp(dot(n, v), 0.0, 1.0);
        float open = texelFetch(ao, here, 0).r;
        specular = vec4(ambient * open * texture(directional_albedo, vec2(cosine, 0.5)).r, 0.0);
        return;
    }
    vec3 l = direction_to_light(p.xyz);
    float cosine = dot(n, l);
    if (cosine <= 0.0) return;
    float seen = has_shadow ? texelFetch(visibility, here, 0).r : 1.0;
    vec3 h = l + v;
    float hh = dot(h, h);
    if (hh < 1e-4) return;  // light straight behind the surface point: nothing is reflected
    vec3 half_vector = h * inversesqrt(hh);
    float nh = max(dot(n, half_vector), 0.0);
    float d = mix(beckmann_pi(nh, roughness.x), beckmann_pi(nh, roughness.y), second_lobe);
    float fresnel = f0 + (1.0 - f0) * pow(1.0 - clamp(dot(half_vector, v), 0.0, 1.0), 5.0);
    float f_pi = strength * d * fresnel / hh;
    specular = vec4(incident_irradiance(p.xyz) * (cosine * seen * f_pi), 0.0);
}
