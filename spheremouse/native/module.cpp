#include "spheremouse/native/arrays.h"

namespace spheremouse::wand {
void bind_assign(nb::module_& m);
void bind_colour(nb::module_& m);
void bind_likelihood(nb::module_& m);
void bind_limb(nb::module_& m);
void bind_particles(nb::module_& m);
void bind_refine(nb::module_& m);
}  // namespace spheremouse::wand

NB_MODULE(kernels, m) {
    using namespace spheremouse::wand;
    for (auto bind : {bind_assign, bind_colour, bind_likelihood, bind_limb, bind_particles, bind_refine}) bind(m);
}
