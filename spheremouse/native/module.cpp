#include "spheremouse/native/arrays.h"

namespace spheremouse::wand {
void bind_colour(nb::module_& m);
}

NB_MODULE(kernels, m) {
    m.doc() = "Per-frame functions in C++. Each source lies beside the Python module that calls it.";
    spheremouse::wand::bind_colour(m);
}
