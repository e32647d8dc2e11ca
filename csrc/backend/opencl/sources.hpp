// Kernel sources joined as text. OpenCL gets one string with #line markers instead of #include and
// a search path, since drivers' binary caches miss a changed file that is only included.
#pragma once
#include <string>

#include "backend/device.hpp"

namespace tledface {

// The folder of the kernels that ship with the package; the environment variable TLEDFACE_KERNELS
// points at another one while developing.
void set_kernel_folder(const std::string& path);

// What the device compiles: prologue (TLED_OPENCL, TLED_LANES, TLED_VECTOR_ROWS, TLED_DOUBLE), then
// `file` of the kernel folder with its #include "x" lines expanded, each file once. Throws
// InputError for a file that is not there.
std::string kernel_source(const std::string& file, const ProgramOptions& options);

// As above from the shipped folder, whatever TLEDFACE_KERNELS says.
std::string shipped_kernel_source(const std::string& file, const ProgramOptions& options);

}  // namespace tledface
