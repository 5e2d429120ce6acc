#version 330 core
// jacobian: position, normal_geometry -> jacobian (R32F): skin area that a pixel shows, relative to
// a facing pixel at the camera's working distance.
// dA/da = cos^3(phi_i) |x|^2 / cos(phi_j)  (Mikkelsen 2010; paper eq. 8, which calls it an edge
// image); with |x| = z / cos(phi_i) that is z^2 cos(phi_i) / cos(phi_j).
// phi_i: pixel ray to optical axis; phi_j: ray to normal, its cosine clamped: no raw 1/cos.
// Check alone: 1 in the middle of the face, rising smoothly toward silhouettes.
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform float working_distance_mm;

layout(location = 0) out float jacobian;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    jacobian = 0.0;
    if (p.a == 0.0) return;
    vec3 to_eye = direction_to_eye(p.xyz);
    float cos_i = to_eye.z;
    float cos_j = max(abs(dot(texelFetch(normal_geometry, here, 0).xyz, to_eye)), 0.05);
    float side = px_per_mm(working_distance_mm) / px_per_mm(-p.z);  // of a facing pixel
    jacobian = side * side * cos_i / cos_j;
}
