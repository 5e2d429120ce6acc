// Maps read at the mip level that a pixel's footprint asks for, from exact slopes of uv.
//
// GL takes the slopes from differences between neighbours, once for two by two pixels. Under a wide
// lens uv / w bends within two pixels, and which two they are differs in a mirrored picture. What is
// linear on the screen, uv / w and 1 / w, has the same difference everywhere on a triangle, and the
// quotient rule gives the slopes of uv at the pixel itself.
vec4 map_at(sampler2D map, vec2 uv, float bias) {
    vec3 line = vec3(uv, 1.0) * gl_FragCoord.w;
    vec3 right = dFdx(line), up = dFdy(line);
    vec2 texels = vec2(textureSize(map, 0)) / gl_FragCoord.w;
    vec2 across = (right.xy - uv * right.z) * texels;
    vec2 along = (up.xy - uv * up.z) * texels;
    float level = 0.5 * log2(max(dot(across, across), dot(along, along)));
    return textureLod(map, uv, level + bias);
}
