// The constants of kernels_cl/layout.cl for C++: the same text, so the two cannot differ.
#pragma once
#include "../../kernels_cl/layout.cl"
