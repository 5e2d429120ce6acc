#version 330 core
// jacobian: position, normal_geometry -> jacobian (R32F): skin area that a pixel shows, relative to
// a facing pixel at the camera's working distance.
// dA/da = cos^3(phi_i) |x|^2 / cos(phi_j)  (Mikkelsen 2010; paper eq. 8, which calls it an edge
// image); with |x| = z / cos(phi_i) that is z^2 cos(phi_i) / cos(phi_j).
// phi_i: pixel ray to optical axis; phi_j: ray to normal, its cosine clamped: no raw 1/cos. Toward a
// silhouette t = cos^2(phi_j) falls evenly to 0, and what the pixel shows is the mean of 1/sqrt(t) over its
// width w, 2 / (sqrt(t - w/2) + sqrt(t + w/2)): of the middle alone it is anything up to the clamp, as the
// sample falls, and a kernel that reaches many silhouettes hangs on the luckiest of them.
// Check alone: 1 in the middle of the face, rising smoothly toward silhouettes.
#include "screen.glsl"
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform float working_distance_mm;

layout(location = 0) out float jacobian;

float squared_cosine(ivec2 pixel, vec4 p) {
    float c = dot(texelFetch(normal_geometry, pixel, 0).xyz, direction_to_eye(p.xyz));
    return c * c;
}

// To the neighbour along `way` that is nearer in depth: across a silhouette there is no slope.
float change(ivec2 here, ivec2 way, vec4 p, float t) {
    ivec2 last = textureSize(position, 0) - 1;
    float found = 0.0, nearest = 1e30;
    for (int side = -1; side <= 1; side += 2) {
        ivec2 there = clamp(here + side * way, ivec2(0), last);
        vec4 q = texelFetch(position, there, 0);
        float gap = abs(q.z - p.z);
        if (q.a == 0.0 || there == here || gap >= nearest) continue;
        nearest = gap;
        found = abs(squared_cosine(there, q) - t);
    }
    return found;
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    jacobian = 0.0;
    if (p.a == 0.0) return;
    vec3 to_eye = direction_to_eye(p.xyz);
    float cos_i = to_eye.z;
    float t = squared_cosine(here, p);
    float wide = 0.5 * (change(here, ivec2(1, 0), p, t) + change(here, ivec2(0, 1), p, t));
    float cos_j = 0.5 * (sqrt(max(t - wide, 0.0)) + sqrt(min(t + wide, 1.0)));
    // The rest of a pixel whose middle lies past the silhouette is not drawn: it is this one's. With this
    // share of it, over all places of the silhouette, no area is lost: (2/3 sqrt 2 - A) / (A - B), with
    // A = 2 (sqrt 2 - 1) and B = (4 - 2 sqrt 2) / 3, integrals of 1 and of t / wide over sqrt(1 + t / wide).
    cos_j /= 1.0 + 0.26 * max(1.0 - t / max(wide, 1e-12), 0.0);
    float side = px_per_mm(working_distance_mm) / px_per_mm(-p.z);  // of a facing pixel
    jacobian = side * side * cos_i / max(cos_j, 0.05);
}
