// Looking into a light's shadow map (R32F, mm from the light's near plane along its axis).
// Include light.glsl before it.
uniform sampler2D shadow_map;
uniform mat4 light_from_view;     // mm -> mm around the subject's centre, lamp up +Z
uniform mat4 clip_from_light;
uniform float light_front_mm;    // from the subject's centre to the near plane

struct LightPoint {
    bool in_map;
    vec2 uv;             // in the shadow map, [0, 1]
    float depth_mm;      // from the near plane
    float mm_per_uv;     // width of the map at this depth, mm
    float way_per_depth; // mm along the light's ray per mm of depth: > 1 off a lamp's axis
    vec2 slope;          // depth per mm across the map, of the receiver's own tangent plane
};

// Where a surface point (view, mm) with this normal lies in the light's view.
LightPoint light_point(vec3 position, vec3 normal) {
    vec3 at = (light_from_view * vec4(position, 1.0)).xyz;
    vec3 n = mat3(light_from_view) * normal;
    vec4 clip = clip_from_light * vec4(at, 1.0);
    LightPoint p;
    float from_lamp = max(light_distance_mm - at.z, 1e-6);
    p.uv = clip.xy / max(clip.w, 1e-6) * 0.5 + 0.5;
    p.in_map = clip.w > 0.0 && all(greaterThanEqual(p.uv, vec2(0.0))) && all(lessThanEqual(p.uv, vec2(1.0)));
    p.depth_mm = light_front_mm - at.z;
    p.mm_per_uv = 2.0 * max(clip.w, 1e-6) / clip_from_light[0][0];
    p.way_per_depth = light_is_near ? length(vec3(at.xy, from_lamp)) / from_lamp : 1.0;
    // Clamped where the light grazes: no raw 1/cos.
    float facing = light_is_near ? n.z - dot(n.xy, at.xy) / from_lamp : n.z;
    facing = facing < 0.0 ? min(facing, -0.1) : max(facing, 0.1);
    p.slope = clamp(n.xy / facing, -8.0, 8.0);
    return p;
}

// Depth of the receiver's tangent plane `offset` mm across the map from it (measured at its depth).
// In perspective the plane N.x = N.p meets the ray at z = z0 / (1 - slope . offset / z0).
float plane_depth(LightPoint p, vec2 offset) {
    float rise = dot(p.slope, offset);
    if (!light_is_near) return p.depth_mm + rise;
    // Written as what it adds, which keeps its digits when the lamp is far.
    float share = rise / max(p.depth_mm + light_distance_mm - light_front_mm, 1e-6);
    return p.depth_mm + rise / max(1.0 - share, 0.25);
}

// Depth in the texel nearest to `offset`; moves `offset` to that texel's centre, where the plane
// must be asked for a lit slope not to shadow itself.
float first_depth(LightPoint p, inout vec2 offset) {
    vec2 size = vec2(textureSize(shadow_map, 0));
    vec2 texel = clamp(floor((p.uv + offset / p.mm_per_uv) * size), vec2(0.0), size - 1.0);
    offset = ((texel + 0.5) / size - p.uv) * p.mm_per_uv;
    return texelFetch(shadow_map, ivec2(texel), 0).r;
}
