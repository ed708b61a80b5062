#include "spheremouse/native/arrays.h"

namespace spheremouse {
void bind_camera(nb::module_& m);
void bind_matching(nb::module_& m);
void bind_rotation(nb::module_& m);
}  // namespace spheremouse
namespace spheremouse::ball {
void bind_align(nb::module_& m);
void bind_anchors(nb::module_& m);
void bind_appearance(nb::module_& m);
void bind_chart(nb::module_& m);
void bind_centre_offset(nb::module_& m);
void bind_evidence(nb::module_& m);
void bind_fit(nb::module_& m);
void bind_learn(nb::module_& m);
void bind_outline(nb::module_& m);
void bind_photo(nb::module_& m);
void bind_hypotheses(nb::module_& m);
void bind_points(nb::module_& m);
void bind_search(nb::module_& m);
void bind_so3_frame(nb::module_& m);
void bind_so3_map(nb::module_& m);
void bind_so3_match(nb::module_& m);
void bind_so3_motion(nb::module_& m);
void bind_so3_move(nb::module_& m);
void bind_so3_sightings(nb::module_& m);
void bind_so3_update(nb::module_& m);
void bind_windows(nb::module_& m);
}  // namespace spheremouse::ball
namespace spheremouse::wand {
void bind_assign(nb::module_& m);
void bind_colour(nb::module_& m);
void bind_likelihood(nb::module_& m);
void bind_limb(nb::module_& m);
void bind_particles(nb::module_& m);
void bind_refine(nb::module_& m);
}  // namespace spheremouse::wand

NB_MODULE(kernels, m) {
    using namespace spheremouse;
    const nb::module_ numpy = nb::module_::import_("numpy");
    const auto look_up = [&](nb::handle& to, const char* name) { to = nb::object(numpy.attr(name)).release(); };
    look_up(numpy_zeros, "zeros");
    look_up(dtype<double>, "float64");
    look_up(dtype<float>, "float32");
    look_up(dtype<int64_t>, "int64");
    look_up(dtype<uint8_t>, "uint8");
    look_up(dtype<bool>, "bool_");
    for (auto bind : {bind_camera, bind_matching, bind_rotation}) bind(m);
    for (auto bind : {ball::bind_align,         ball::bind_anchors,   ball::bind_learn,         ball::bind_appearance,
                      ball::bind_centre_offset, ball::bind_chart,     ball::bind_evidence,      ball::bind_fit,
                      ball::bind_outline,       ball::bind_photo,     ball::bind_hypotheses,    ball::bind_points,
                      ball::bind_search,        ball::bind_so3_frame, ball::bind_so3_map,       ball::bind_so3_match,
                      ball::bind_so3_motion,    ball::bind_so3_move,  ball::bind_so3_sightings, ball::bind_so3_update,
                      ball::bind_windows})
        bind(m);
    for (auto bind : {wand::bind_assign, wand::bind_colour, wand::bind_likelihood, wand::bind_limb,
                      wand::bind_particles, wand::bind_refine})
        bind(m);
}
