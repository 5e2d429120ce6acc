// An environment light as the passes see it (render/environment.py).
uniform mat3 picture_from_view;

// Where a direction (view, unit) lies in a latitude-longitude picture: row 0 at +Y, middle at +Z.
vec2 picture_uv(vec3 direction) {
    vec3 d = picture_from_view * direction;
    float around = abs(d.x) + abs(d.z) > 1e-7 ? atan(d.x, d.z) : 0.0;
    return vec2(0.5 - around / (2.0 * PI), acos(clamp(d.y, -1.0, 1.0)) / PI);
}
