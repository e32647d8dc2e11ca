// The constants of kernels_cl/sliding_layout.cl for C++: the same text.
#pragma once
#include "../../kernels_cl/sliding_layout.cl"
