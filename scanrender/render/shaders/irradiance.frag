#version 330 core
// irradiance: position, normal_shading, ao, visibility_N -> irradiance (RGB, units of pi).
// Run once for the ambient light (KIND 0), then, adding, per environment (2) and per lamp (1).
// E = sum over lights of (1 - rho_dt(N.L)) max(0, N.L) visibility E_light   (d'Eon & Luebke 2007,
// GPU Gems 3 ch. 14: what the specular reflects does not enter).
// Check alone: a grey plaster cast; no albedo, no highlights.
#include "common.glsl"
#include "environment.glsl"
#include "light.glsl"
uniform sampler2D position;
uniform sampler2D normal_shading;
uniform sampler2D ao;
uniform sampler2D visibility;
uniform sampler2D directional_albedo;  // over cos theta in [0, 1]
uniform sampler2D irradiance_map;      // over directions, entry loss included, units of pi
uniform bool has_shadow;
uniform vec3 ambient;                  // RGB in units of pi
uniform float mean_directional_albedo; // cosine-weighted mean of rho_dt, for light from everywhere

layout(location = 0) out vec4 irradiance;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    irradiance = vec4(0.0);
    if (p.a == 0.0) return;
    if (KIND == 0) {
        float open = texelFetch(ao, here, 0).r;
        irradiance = vec4(ambient * open * (1.0 - mean_directional_albedo), 1.0);
        return;
    }
    vec3 n = texelFetch(normal_shading, here, 0).xyz;
    if (KIND == 2) {
        float open = texelFetch(ao, here, 0).r;
        irradiance = vec4(open * textureLod(irradiance_map, picture_uv(n), 0.0).rgb, 0.0);
        return;
    }
    float cosine = dot(n, direction_to_light(p.xyz));
    if (cosine <= 0.0) return;
    float seen = has_shadow ? texelFetch(visibility, here, 0).r : 1.0;
    float enters = 1.0 - texture(directional_albedo, vec2(cosine, 0.5)).r;
    irradiance = vec4(incident_irradiance(p.xyz) * (cosine * seen * enters), 0.0);
}
