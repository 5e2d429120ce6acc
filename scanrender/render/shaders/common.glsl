// Shared by the full-screen passes. Spaces: view = millimetres, camera at the origin, looks along
// -Z. Pixels are addressed bottom-up, as GL does; rows are flipped once, at readback.

const float PI = 3.14159265358979;
const float GOLDEN_ANGLE = 2.39996322972865;
const float ROW_TURN = 2.6025848473321;  // sqrt 2 of a turn

// Golden-angle disk: point i of n on the unit disk, uniform by area, turned by `spiral.x`
// radians, then mirrored in x where `spiral.y` is -1 (a spiral has a hand, a lamp has none).
// Deterministic; (i + 0.5) keeps it off the centre and off the rim.
vec2 disk_point(int i, int n, vec2 spiral) {
    float radius = sqrt((float(i) + 0.5) / float(n));
    float angle = float(i) * GOLDEN_ANGLE + spiral.x;
    return radius * vec2(spiral.y * cos(angle), sin(angle));
}

// This pixel's spiral. Where four pixels share their taps it is mirrored from column to column and
// turned from row to row: diffusion averages them, and a mirrored picture has the mirrored ones.
vec2 spiral_here(float turn, bool is_shared) {
    if (!is_shared) return vec2(turn, 1.0);
    ivec2 odd = ivec2(gl_FragCoord.xy) & 1;
    return vec2(turn + ROW_TURN * float(odd.y), odd.x == 0 ? 1.0 : -1.0);
}
