// A directional, point or spot light as the passes see it.
uniform vec3 light_to_light;      // view space, unit, subject centre -> light
uniform vec3 light_position;      // view space, mm (point and spot)
uniform bool light_is_near;       // it stands somewhere: point or spot
uniform float light_distance_mm;  // lamp to subject centre, where its irradiance is stated
uniform float light_radius_mm;    // of the lamp; inside it the light grows no more
uniform vec2 light_cone;          // 1 - cosine where it begins to fade, and at the dark rim
uniform vec3 light_irradiance;    // RGB in units of pi, at the subject's centre

// Unit vector from the surface point to the light. A point inside the lamp gets its axis.
vec3 direction_to_light(vec3 position) {
    vec3 d = light_position - position;
    float squared = dot(d, d);
    return light_is_near && squared > 1e-12 ? d * inversesqrt(squared) : light_to_light;
}

// Irradiance at normal incidence, in units of pi: inverse square from the stated distance, cone.
vec3 incident_irradiance(vec3 position) {
    if (!light_is_near) return light_irradiance;
    vec3 d = light_position - position;
    float nearest = max(light_radius_mm * light_radius_mm, 1e-6);
    float fall = light_distance_mm * light_distance_mm / max(dot(d, d), nearest);
    // 1 - cosine as half the squared chord: a cone of a degree is all within the last four digits of
    // a cosine.
    vec3 chord = direction_to_light(position) - light_to_light;
    float shown = 1.0 - smoothstep(light_cone.x, light_cone.y, 0.5 * dot(chord, chord));
    return light_irradiance * fall * shown;
}
