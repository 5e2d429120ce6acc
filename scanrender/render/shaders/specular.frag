#version 330 core
// specular: position, normals, ao, visibility_N -> specular (RGB radiance, added over lights).
// Kelemen & Szirmay-Kalos 2001: f = D_Beckmann(N.H, m) F(H.V) / (h.h), h = L + V un-normalised.
// D carries the 1/pi that GPU Gems 3 drops; irradiance in units of pi cancels it here.
// Never blurred. KIND: 0 ambient, 1 lamp, 2 environment. Ambient: directional albedo times the constant light, dimmed by ao.
// Check alone: highlights as sharp as the normal map; none in shadow.
#include "common.glsl"
#include "environment.glsl"
#include "light.glsl"
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D ao;
uniform sampler2D visibility;
uniform sampler2D directional_albedo;
uniform sampler2D normal_geometry;
uniform sampler2D lobe_map_0;    // the environment through each lobe, over mirror directions
uniform sampler2D lobe_map_1;
uniform sampler2D lobe_albedo;   // over cos theta: what each lobe reflects, with its share
uniform bool has_shadow;
uniform vec3 ambient;
uniform float f0;
uniform vec2 roughness;      // Beckmann m of each lobe
uniform float second_lobe;   // share of the second
uniform float strength;

layout(location = 0) out vec4 specular;

// Beckmann & Spizzichino 1963, times pi: exp(-tan^2 / m^2) / (m^2 cos^4), over cos^2 and sin^2: of a
// narrow lobe 1 - cos^2 would be left with no digits where it peaks.
float beckmann_pi(float c2, float s2, float m) {
    float m2 = m * m;
    return exp(-s2 / (c2 * m2)) / (m2 * c2 * c2);
}

// Share of a cone of half angle `lobe` that lies in the cone `open` around the normal, `apart` from
// its axis (Oat & Sander 2007), all in radians.
float cone_overlap(float open, float lobe, float apart) {
    float inner = abs(open - lobe);
    float t = 1.0 - clamp((apart - inner) / max(open + lobe - inner, 1e-4), 0.0, 1.0);
    float whole = 1.0 - cos(min(open, lobe));
    return whole * t * t * (3.0 - 2.0 * t) / (1.0 - cos(lobe));
}

// How much of a lobe the same surroundings hide that hide the sky: the sky that is seen is a cone
// around the normal with the same ambient occlusion (Jimenez et al. 2016), so that what lies low is
// hidden first. Relative to an open surface, whose lobe the table already ends at the horizon.
float specular_occlusion(float cosine, float share, float m) {
    float open = acos(sqrt(clamp(1.0 - share, 0.0, 1.0)));
    float lobe = 2.0 * atan(0.7 * m);
    float apart = acos(cosine);
    return clamp(cone_overlap(open, lobe, apart) / cone_overlap(0.5 * PI, lobe, apart), 0.0, 1.0);
}

// Split sum (Karis 2013): the environment through each lobe times what the lobe reflects.
vec3 reflected_environment(ivec2 here, vec3 n, vec3 v) {
    float cosine = clamp(dot(n, v), 0.0, 1.0);
    vec3 mirror = reflect(-v, n);
    float open = texelFetch(ao, here, 0).r;
    vec2 reflects = texture(lobe_albedo, vec2(cosine, 0.5)).rg;
    // A normal map can mirror what lies behind the surface.
    float above = clamp(1.0 + dot(mirror, texelFetch(normal_geometry, here, 0).xyz), 0.0, 1.0);
    vec2 uv = picture_uv(mirror);
    vec3 first = textureLod(lobe_map_0, uv, 0.0).rgb * specular_occlusion(cosine, open, roughness.x);
    vec3 second = textureLod(lobe_map_1, uv, 0.0).rgb * specular_occlusion(cosine, open, roughness.y);
    return above * above * (reflects.x * first + reflects.y * second);
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    specular = vec4(0.0);
    if (p.a == 0.0) return;
    vec3 n = texelFetch(normal_shading, here, 0).xyz;
    vec3 v = direction_to_eye(p.xyz);
    if (KIND == 0) {
        float cosine = clamp(dot(n, v), 0.0, 1.0);
        float open = texelFetch(ao, here, 0).r;
        specular = vec4(ambient * open * texture(directional_albedo, vec2(cosine, 0.5)).r, 0.0);
        return;
    }
    if (KIND == 2) {
        specular = vec4(reflected_environment(here, n, v), 0.0);
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
    float c2 = max(nh * nh, 1e-4);
    vec3 across = cross(n, half_vector);
    float s2 = nh > 0.0 ? dot(across, across) : 1.0;
    float d = mix(beckmann_pi(c2, s2, roughness.x), beckmann_pi(c2, s2, roughness.y), second_lobe);
    float fresnel = f0 + (1.0 - f0) * pow(1.0 - clamp(dot(half_vector, v), 0.0, 1.0), 5.0);
    float f_pi = strength * d * fresnel / hh;
    specular = vec4(incident_irradiance(p.xyz) * (cosine * seen * f_pi), 0.0);
}
