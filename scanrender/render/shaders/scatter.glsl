// What every diffusion filter shares: how much a tap counts, and how light and mask add up.
// A filter defines WEIGHT (float, or vec3 for a kernel per channel) and includes this. Switches:
//   HALO_DEPTH    what a depth step takes from a tap goes to the centre (Jimenez); a step is what
//                 leaves the surface's own slope
//   HALO_MEASURE  it is lost to the normalization; with diffusion_input's jacobian in the mask the
//                 result is a mean over the surface (Mikkelsen 2010)
//   GUIDE_EDGE    exp(-c |E_p - E_q|), the cross bilateral filter of the paper, eq. 7
//   GUIDE_LAB     floor + (1 - floor) exp(-dE^2 / 2s^2), eq. 9 as it must read: weights times I_q
//   CURVATURE     the kernel's width depends on the curvature
//   JITTER        taps move inside their cells, by pixel and sample index only
//   MISSING_MASS  what the picture hides is not made up for: sums are left as they are
//   FOLD          the kernel reaches past the picture, guard band and all: what lies there is taken to be
//                 as what lies inside, mirrored at the edge. The last pixel in its place would be
//                 dragged along rows and columns; a kernel wider than all of it would be lost.
//   WEIGHTS       weight_sum and rejected are written instead of light
//   CHAIN         what is written is blurred further
// Sums are normalized by the mask that was met, and premultiplied again: by the pixel's own mask, or in
// a CHAIN by the mean of the masks that were met. Taps of a later, wider blur are many pixels apart.
// They may do that because the light has been blurred before, and so must be what it is weighed by: a
// pixel at a silhouette, which shows up to 20 times the surface of others, would count for all around it.
#include "screen.glsl"
uniform sampler2D source;        // RGB premultiplied, a = mask
uniform sampler2D depth_mm;      // -z, 0 where there is no surface
uniform vec2 direction;          // (1,0) or (0,1)
#if defined(HALO_DEPTH) || defined(HALO_MEASURE)
uniform sampler2D normal_geometry;
uniform vec4 ray;                // view xy / depth (ortho: xy) = gl_FragCoord.xy * ray.xy + ray.zw
#endif
#ifdef GUIDE_EDGE
uniform sampler2D edge_guide;
uniform float edge_contrast;     // c
#endif
#ifdef GUIDE_LAB
uniform sampler2D lab;
uniform float lab_falloff;       // 1 / 2s^2, s in dE
uniform float lab_floor;
#endif
#ifdef CURVATURE
uniform sampler2D curvature;     // 1/mm
uniform vec4 width_by_curvature; // factor = x + y min(k z, 1), k = max(curvature, 0)
#endif
#ifdef JITTER
uniform int sample_index;
#endif

#ifdef WEIGHTS
layout(location = 0) out vec4 weight_sum;
layout(location = 1) out float rejected;
uniform vec3 share;              // RGB, of this draw in the whole filter
uniform float rejected_share;
#else
layout(location = 0) out vec4 scattered;
#endif

// Beyond any picture; what lies much further does not fit an int.
const float FARTHEST_PX = 1048576.0;

ivec2 here = ivec2(gl_FragCoord.xy);
ivec2 last = textureSize(depth_mm, 0) - 1;
vec4 centre;
float centre_z;
float mm_per_px;                 // facing, at the centre's depth
vec3 sum = vec3(0.0);
WEIGHT total = WEIGHT(0.0);
#ifdef CHAIN
WEIGHT met = WEIGHT(0.0);        // weights of what is a surface, whatever its mask
#endif
#if defined(HALO_DEPTH) || defined(HALO_MEASURE)
vec3 centre_ray;                 // way of the ray, z = -1
vec3 centre_point;               // view, mm
vec3 surface_step;               // mm that one pixel step along the direction moves on the surface
#endif
#ifdef GUIDE_EDGE
float centre_edge;
#endif
#ifdef GUIDE_LAB
vec3 centre_lab;
#endif
#ifdef WEIGHTS
WEIGHT asked = WEIGHT(0.0);
float taps_met = 0.0;
float taps_rejected = 0.0;
#endif

#if defined(HALO_DEPTH) || defined(HALO_MEASURE)
vec3 view_point(vec2 pixel, float z) {
    vec2 xy = pixel * ray.xy + ray.zw;
    return vec3(is_orthographic ? xy : xy * z, -z);
}
#endif

// False where there is no surface: nothing scatters there.
bool begin() {
    centre_z = texelFetch(depth_mm, here, 0).r;
#ifdef WEIGHTS
    weight_sum = vec4(0.0);
    rejected = 0.0;
#else
    scattered = vec4(0.0);
#endif
    if (centre_z <= 0.0) return false;
    centre = texelFetch(source, here, 0);
    mm_per_px = 1.0 / px_per_mm(centre_z);
#if defined(HALO_DEPTH) || defined(HALO_MEASURE)
    // On the plane n.(x - p) = 0 a step e moves the point by (z / f) (e - r (n.e) / (n.r)), r = p / z.
    centre_point = view_point(gl_FragCoord.xy, centre_z);
    centre_ray = is_orthographic ? vec3(0.0, 0.0, -1.0) : centre_point / max(centre_z, 1e-6);
    vec3 n = texelFetch(normal_geometry, here, 0).xyz;
    float facing = dot(n, centre_ray);
    float least = 0.05 * length(centre_ray);  // no raw 1/cos
    facing = facing < 0.0 ? min(facing, -least) : max(facing, least);
    surface_step = mm_per_px * (vec3(direction, 0.0) - centre_ray * (dot(n, vec3(direction, 0.0)) / facing));
#endif
#ifdef GUIDE_EDGE
    centre_edge = texelFetch(edge_guide, here, 0).r;
#endif
#ifdef GUIDE_LAB
    centre_lab = texelFetch(lab, here, 0).xyz;
#endif
    return true;
}

float width_factor() {
#ifdef CURVATURE
    float k = max(texelFetch(curvature, here, 0).r, 0.0);
    return width_by_curvature.x + width_by_curvature.y * min(k * width_by_curvature.z, 1.0);
#else
    return 1.0;
#endif
}

// Uniform in [-0.5, 0.5), from the pixel and the sample alone: a turntable does not flicker.
// (PCG hash, Jarzynski & Olano 2020.)
float noise() {
#ifdef JITTER
    uint v = uint(here.x) * 1664525u + uint(here.y) * 22695477u
           + uint(sample_index) * 2891336453u + uint(direction.y) * 747796405u;
    v = v * 747796405u + 2891336453u;
    uint word = ((v >> ((v >> 28) + 4u)) ^ v) * 277803737u;
    word = (word >> 22) ^ word;
    return float(word >> 8) / 16777216.0 - 0.5;
#else
    return 0.0;
#endif
}

ivec2 inside(ivec2 texel) {
#ifdef FOLD
    vec2 size = vec2(last + 1);
    vec2 at = mod(abs(vec2(texel) + 0.5), 2.0 * size);
    texel = ivec2(min(at, 2.0 * size - at));
#endif
    return clamp(texel, ivec2(0), last);
}

// Squared distance in mm that the pixel `steps` away has beyond `flat_mm2`.
float beyond_mm2(ivec2 texel, float steps, float flat_mm2) {
#if defined(HALO_DEPTH) || defined(HALO_MEASURE)
    float z = texelFetch(depth_mm, texel, 0).r;
    // Where nothing was drawn there is no depth; its mask of 0 already keeps it out.
    if (z <= 0.0) return 0.0;
#ifdef HALO_MEASURE
    vec3 d = view_point(vec2(texel) + 0.5, z) - centre_point;
    return dot(d, d) - flat_mm2;
#else
    // From the surface's own slope: turned skin is no step. Up to 45 deg, so that the last pixels
    // before a silhouette do not take what lies behind for their own surface.
    float slope = clamp(-surface_step.z, -mm_per_px, mm_per_px);
    float dz = z - centre_z - slope * steps;
    return dz * dz;
#endif
#else
    return 0.0;
#endif
}

float guide(ivec2 texel) {
    float w = 1.0;
#ifdef GUIDE_EDGE
    w *= exp(-edge_contrast * abs(texelFetch(edge_guide, texel, 0).r - centre_edge));
#endif
#ifdef GUIDE_LAB
    vec3 d = texelFetch(lab, texel, 0).xyz - centre_lab;
    w *= lab_floor + (1.0 - lab_floor) * exp(-dot(d, d) * lab_falloff);
#endif
    return w;
}

void add(WEIGHT k, vec4 tap, WEIGHT near, float guided) {
#ifdef WEIGHTS
    float met = min(tap.a / max(centre.a, 1e-8), 1.0);
    WEIGHT kept = near * (guided * met);
    asked += k;
    total += k * kept;
    taps_met += 1.0;
    taps_rejected += dot(k, kept) < 0.5 * dot(k, WEIGHT(1.0)) ? 1.0 : 0.0;
#else
#ifdef HALO_DEPTH
    WEIGHT w = k * guided;
    sum += w * mix(centre.rgb, tap.rgb, near);
    total += w * (centre.a + (tap.a - centre.a) * near);
#else
    WEIGHT w = k * near * guided;
    sum += w * tap.rgb;
    total += w * tap.a;
#endif
#ifdef CHAIN
    met += tap.a > 0.0 ? w : WEIGHT(0.0);
#endif
#endif
}

// The pixel `steps` away along the direction; `step_mm2` is the squared length of one step.
void add_at(WEIGHT k, int steps, float step_mm2, WEIGHT falloff) {
    ivec2 straight = here + steps * ivec2(direction);
    ivec2 texel = inside(straight);
    float flat_mm2 = float(steps) * float(steps) * step_mm2;
#ifdef FOLD
    // Of a surface that is not known nothing is told but that it goes on.
    float beyond = texel == straight ? beyond_mm2(texel, float(steps), flat_mm2) : 0.0;
#else
    float beyond = beyond_mm2(texel, float(steps), flat_mm2);
#endif
    // Nearer than a flat step: perspective, or skin that bends toward the eye. Never for long.
    WEIGHT near = min(exp(-beyond * falloff), WEIGHT(4.0));
    add(k, texelFetch(source, texel, 0), near, guide(texel));
}

// A tap between two pixels: each by its own depth and guide, so that nothing crosses with a filter.
void add_between(WEIGHT k, float offset_px, float step_mm2, WEIGHT falloff) {
    offset_px = clamp(offset_px, -FARTHEST_PX, FARTHEST_PX);
    float low = floor(offset_px);
    float share = offset_px - low;
    add_at(k * (1.0 - share), int(low), step_mm2, falloff);
    add_at(k * share, int(low) + 1, step_mm2, falloff);
}

void finish() {
#ifdef WEIGHTS
    weight_sum = vec4(share * vec3(total / asked), 0.0);
    rejected = rejected_share * taps_rejected / taps_met;
#else
    // The centre's own range weight is 1: the sum cannot vanish, even with an even number of taps.
    const float KEEP = 1e-5;
    sum += KEEP * centre.rgb;
    total += WEIGHT(KEEP * centre.a);
#if defined(CHAIN)
    scattered = vec4(sum, total) / (met + KEEP);
#elif defined(MISSING_MASS)
    scattered = vec4(sum * centre.a, centre.a);
#else
    scattered = vec4(sum * (centre.a / max(total, WEIGHT(1e-12))), centre.a);
#endif
#endif
}

#ifdef HALO_MEASURE
// How much longer one pixel step along the direction is on the surface than facing, squared.
float stretch2() { return max(dot(surface_step, surface_step) / (mm_per_px * mm_per_px), 1e-2); }
#endif
