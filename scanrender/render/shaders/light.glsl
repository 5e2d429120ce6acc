// A directional or spot light as the passes see it.
uniform vec3 light_to_light;      // view space, unit, subject centre -> light
uniform vec3 light_position;      // view space, mm (spots only)
uniform bool light_is_spot;
uniform float light_distance_mm;  // spot to subject centre, where its irradiance is stated
uniform vec2 light_cone;          // cosines at the dark rim and where it is full; (-2, -1.5) = none
uniform vec3 light_irradiance;    // RGB in units of pi, at the subject's centre

// Unit vector from the surface point to the light.
vec3 direction_to_light(vec3 position) {
    return light_is_spot ? normalize(light_position - position) : light_to_light;
}

// Irradiance at normal incidence, in units of pi: inverse square from the stated distance, cone.
vec3 incident_irradiance(vec3 position) {
    if (!light_is_spot) return light_irradiance;
    vec3 d = light_position - position;
    float fall = light_distance_mm * light_distance_mm / max(dot(d, d), 1e-6);
    float cosine = dot(normalize(d), light_to_light);
    return light_irradiance * fall * smoothstep(light_cone.x, light_cone.y, cosine);
}
