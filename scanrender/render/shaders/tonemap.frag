#version 330 core
// tonemap: beauty -> display (RGB in [0, 1], sRGB display).
// Background, exposure, then the OpenColorIO view as a 3-D table over log2 of scene-linear values
// (render/view.py makes it and states its range and error).
uniform sampler2D beauty;
uniform sampler3D view_table;
uniform vec3 background;
uniform float exposure;      // 2^EV
uniform vec2 log2_range;     // stops at the table's first and last texel
uniform float table_size;

layout(location = 0) out vec4 display;

void main() {
    vec4 b = texelFetch(beauty, ivec2(gl_FragCoord.xy), 0);
    vec3 linear = max((b.rgb + (1.0 - b.a) * background) * exposure, 0.0);
    float floor_value = exp2(log2_range.x);
    vec3 stops = log2(linear + floor_value);
    vec3 at = clamp((stops - log2_range.x) / (log2_range.y - log2_range.x), 0.0, 1.0);
    vec3 shown = texture(view_table, (at * (table_size - 1.0) + 0.5) / table_size).rgb;
    display = vec4(clamp(shown, 0.0, 1.0), 1.0);
}
