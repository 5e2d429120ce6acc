// The camera as a screen-space pass needs it: the only place that knows the projection.
// A pass that measures millimetres on screen includes this file and binds `shot.screen_uniforms`;
// it divides nothing by z itself.
uniform float px_per_mm_at_1mm;  // 0.5 H P11: px per mm at a depth of 1 mm (at any depth if ortho)
uniform bool is_orthographic;

// Pixels per millimetre at this depth (mm, -z), square pixels (DESIGN 4).
float px_per_mm(float depth_mm) {
    return is_orthographic ? px_per_mm_at_1mm : px_per_mm_at_1mm / max(depth_mm, 1e-6);
}

// Unit vector from a surface point (view, mm) to the eye.
vec3 direction_to_eye(vec3 position) {
    return is_orthographic ? vec3(0.0, 0.0, 1.0) : -normalize(position);
}
