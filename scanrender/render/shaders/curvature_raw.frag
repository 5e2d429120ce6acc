#version 330 core
// curvature_raw: position, normal_geometry -> curvature_raw (R32F, 1/mm, convex positive).
// Mean curvature = half the trace of the shape operator, fitted to the differences of position and
// normal toward two neighbours. Of the two neighbours along an axis the one nearer in depth is
// taken, so that the difference does not cross a silhouette (research B11).
// Check alone: no bright line along silhouettes.
uniform sampler2D position;
uniform sampler2D normal_geometry;
uniform float limit_per_mm;  // what a pixel can hold; beyond it is noise

layout(location = 0) out float curvature_raw;

bool difference(ivec2 here, ivec2 axis, vec3 p, vec3 n, out vec3 dp, out vec3 dn) {
    ivec2 last = textureSize(position, 0) - 1;
    // At the picture's edge the neighbour is the pixel itself and its gap is not zero but absent.
    bool has_a = all(lessThanEqual(here + axis, last));
    bool has_b = all(greaterThanEqual(here - axis, ivec2(0)));
    vec4 a = has_a ? texelFetch(position, here + axis, 0) : vec4(0.0);
    vec4 b = has_b ? texelFetch(position, here - axis, 0) : vec4(0.0);
    float gap_a = a.a > 0.0 ? abs(a.z - p.z) : 1e30;
    float gap_b = b.a > 0.0 ? abs(b.z - p.z) : 1e30;
    if (min(gap_a, gap_b) > 1e29) return false;
    ivec2 chosen = gap_a <= gap_b ? axis : -axis;
    dp = texelFetch(position, here + chosen, 0).xyz - p;
    dn = texelFetch(normal_geometry, here + chosen, 0).xyz - n;
    return true;
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(position, here, 0);
    curvature_raw = 0.0;
    if (p.a == 0.0) return;
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;
    vec3 dp1, dn1, dp2, dn2;
    if (!difference(here, ivec2(1, 0), p.xyz, n, dp1, dn1)) return;
    if (!difference(here, ivec2(0, 1), p.xyz, n, dp2, dn2)) return;

    // Tangent basis, then S = [dn1 dn2] [dp1 dp2]^-1 and H = trace(S) / 2.
    vec3 t = normalize(abs(n.x) < 0.9 ? cross(n, vec3(1, 0, 0)) : cross(n, vec3(0, 1, 0)));
    vec3 b = cross(n, t);
    mat2 e = mat2(dot(dp1, t), dot(dp1, b), dot(dp2, t), dot(dp2, b));
    mat2 d = mat2(dot(dn1, t), dot(dn1, b), dot(dn2, t), dot(dn2, b));
    // Both neighbours in one line tell nothing across it; whatever the unit, hence relative.
    if (abs(determinant(e)) <= 1e-6 * (dot(e[0], e[0]) + dot(e[1], e[1]))) return;
    mat2 s = d * inverse(e);
    curvature_raw = clamp(0.5 * (s[0][0] + s[1][1]), -limit_per_mm, limit_per_mm);
}
