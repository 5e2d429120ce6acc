#version 330 core
// edge_guide: position, normal_geometry, albedo -> edge_guide (R32F): what the cross bilateral filters
// compare. NORMALIZED: E = I cos(phi_i) / cos(phi_j), free of distance (the paper's contribution: x on
// the projection plane); else E = I cos^3(phi_i) |x|^2 / cos(phi_j), x in metres, which grows with the
// square of the distance (Mikkelsen 2010; the paper's eq. 8).
// I is grey albedo, never lit light: a shadow must not stop what scatters into it.
// phi_i: pixel ray to optical axis; phi_j: ray to normal, its cosine clamped: raw 1/cos makes inf - inf
// at silhouettes, the paper's black dots. Check alone: albedo in the middle, bright along silhouettes.
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform sampler2D albedo;

layout(location = 0) out float edge_guide;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    edge_guide = 0.0;
    if (p.a == 0.0) return;
    vec3 to_eye = direction_to_eye(p.xyz);
    float cos_i = to_eye.z;
    float cos_j = max(abs(dot(texelFetch(normal_geometry, here, 0).xyz, to_eye)), 0.05);
    float grey = dot(texelFetch(albedo, here, 0).rgb, vec3(1.0 / 3.0));
    edge_guide = grey * cos_i / cos_j;
#ifndef NORMALIZED
    vec3 metres = 1e-3 * p.xyz;
    edge_guide *= cos_i * cos_i * dot(metres, metres);
#endif
}
