// Finds the OpenCL library at run time and the platforms it offers. Search order: the path in
// TLEDFACE_OPENCL_LIBRARY (nothing else is tried then), a libOpenCL that the process already has
// (pyopencl's wheel brings one), libOpenCL.so.1 of the system, paths given to
// add_opencl_library(); of the last two, the first that lists a platform.
#pragma once
#include <string>
#include <vector>

#include "backend/opencl/cl_api.hpp"

namespace tledface {

// Null where no usable library was found. Searches once a process.
const cl::Api* opencl_api();

// Platforms in the loader's order. NVIDIA's driver is asked directly, after the others, where it
// is installed but not registered with the loader (usual in containers).
const std::vector<cl::Platform>& opencl_platforms();

// A further library to try where the system has none, or one without drivers; no effect once the
// search is done.
void add_opencl_library(const std::string& path);

// Platforms of a driver that the loader does not list. Throws InputError where the file cannot be
// opened or is no OpenCL driver.
std::vector<cl::Platform> platforms_of_driver(const std::string& library);

// "CL_OUT_OF_RESOURCES (-5)"
std::string opencl_error_name(cl::Int code);

}  // namespace tledface
