// The depth buffer as depth itself, where its reciprocal is too coarse (camera.py, LINEAR_DEPTH_FROM):
// 24 bits of [near, far] are then the same ten nanometres of a head everywhere.
#ifdef LINEAR_DEPTH
uniform vec2 depth_range_mm;  // near plane, and what lies beyond it
void write_depth(float depth_mm) {
    gl_FragDepth = clamp((depth_mm - depth_range_mm.x) / depth_range_mm.y, 0.0, 1.0);
}
#else
void write_depth(float depth_mm) {}
#endif
