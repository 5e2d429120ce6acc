// Looking into a light's shadow map (R32F, mm from the light's near plane along its axis).
uniform sampler2D shadow_map;
uniform mat4 light_from_view;     // mm -> mm
uniform mat4 clip_from_light;
uniform float light_near_mm;

struct LightPoint {
    vec2 uv;         // in the shadow map, [0, 1]
    float depth_mm;  // from the near plane
    float mm_per_uv; // width of the map at this depth, mm
};

// Depth gradient (mm per mm) in the light's view of the plane with this normal (view space).
// Clamped at grazing: no raw 1/cos.
vec2 plane_slope(vec3 normal) {
    vec3 n = mat3(light_from_view) * normal;
    float facing = n.z < 0.0 ? min(n.z, -0.15) : max(n.z, 0.15);
    return clamp(n.xy / facing, -4.0, 4.0);
}

LightPoint light_point(vec3 position) {
    vec4 in_light = light_from_view * vec4(position, 1.0);
    vec4 clip = clip_from_light * in_light;
    LightPoint p;
    p.uv = clip.xy / clip.w * 0.5 + 0.5;
    p.depth_mm = -in_light.z - light_near_mm;
    p.mm_per_uv = 2.0 * clip.w / clip_from_light[0][0];
    return p;
}
