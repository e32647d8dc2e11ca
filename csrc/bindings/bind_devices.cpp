// Devices for Python: what there is, opening one, and its OpenCL handles for pyopencl.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "backend/device.hpp"
#include "backend/opencl/loader.hpp"
#include "backend/opencl/opencl_device.hpp"
#include "backend/opencl/sources.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"

namespace py = pybind11;

#if defined(__clang__)
#define TLEDFACE_COMPILER "Clang " __clang_version__
#else
#define TLEDFACE_COMPILER "GCC " __VERSION__
#endif

namespace tledface {
namespace {

using ReleaseGil = py::call_guard<py::gil_scoped_release>;

std::string repr(const DeviceInfo& info) {
  const std::string state = info.works ? "works" : "does not work: " + info.reason;
  return "<DeviceInfo " + info.id + " '" + info.name + "' (" + info.kind + ") " + state + ">";
}

// The address behind an OpenCL object, None where there is none.
py::object address(const void* handle) {
  if (!handle) return py::none();
  return py::int_(reinterpret_cast<std::uintptr_t>(handle));
}

const OpenClDevice* as_opencl(const Device& device) {
  return dynamic_cast<const OpenClDevice*>(&device);
}

// The bytes of a C-contiguous array.
py::buffer_info contiguous(const py::buffer& array, bool writable) {
  py::buffer_info info = array.request(writable);
  py::ssize_t stride = info.itemsize;
  for (py::ssize_t axis = info.ndim - 1; axis >= 0; --axis) {
    if (info.shape[axis] != 1 && info.strides[axis] != stride)
      throw InputError("array: not C-contiguous; use numpy.ascontiguousarray");
    stride *= info.shape[axis];
  }
  return info;
}

std::size_t n_bytes(const py::buffer_info& info) {
  return static_cast<std::size_t>(info.size * info.itemsize);
}

void write_buffer(Buffer& buffer, const py::buffer& array, std::size_t offset) {
  const py::buffer_info info = contiguous(array, false);
  py::gil_scoped_release release;
  buffer.write(info.ptr, n_bytes(info), offset);
}

void read_buffer(const Buffer& buffer, const py::buffer& array, std::size_t offset) {
  const py::buffer_info info = contiguous(array, true);
  py::gil_scoped_release release;
  buffer.read(info.ptr, n_bytes(info), offset);
}

// Runs one kernel of program.cl to its end; arguments are Buffers and ints.
void launch(Device& device, const std::string& name, const py::sequence& arguments,
            std::size_t n_items, const std::string& precision, int lanes, bool vector_rows,
            std::size_t local_size) {
  ProgramOptions options;
  options.precision = precision == "double" ? Precision::kDouble : Precision::kSingle;
  options.lanes = lanes;
  options.vector_rows = vector_rows;
  const auto build = [&] {
    py::gil_scoped_release release;
    return device.build(options);
  };
  const auto kernel = build()->kernel(name);
  unsigned index = 0;
  for (const py::handle argument : arguments) {
    if (py::isinstance<Buffer>(argument))
      kernel->set_arg(index, argument.cast<const Buffer&>());
    else
      kernel->set_arg(index, argument.cast<std::int32_t>());
    ++index;
  }
  py::gil_scoped_release release;
  kernel->enqueue(n_items, local_size);
  device.finish();
}

}  // namespace
}  // namespace tledface

void define_devices(py::module_& module) {
  using namespace tledface;

  py::class_<DeviceInfo>(module, "DeviceInfo", "What is known of one device.")
      .def_readonly("id", &DeviceInfo::id)
      .def_readonly("name", &DeviceInfo::name)
      .def_readonly("kind", &DeviceInfo::kind)
      .def_readonly("platform", &DeviceInfo::platform)
      .def_readonly("driver", &DeviceInfo::driver)
      .def_readonly("works", &DeviceInfo::works)
      .def_readonly("reason", &DeviceInfo::reason)
      .def_readonly("has_double", &DeviceInfo::has_double)
      .def_readonly("limits_registers", &DeviceInfo::limits_registers)
      .def_readonly("compute_units", &DeviceInfo::compute_units)
      .def_readonly("memory_bytes", &DeviceInfo::memory_bytes)
      .def_readonly("command_buffers", &DeviceInfo::command_buffers)
      .def("__repr__", &repr);

  py::class_<Buffer>(module, "Buffer", "Memory of a device.")
      .def_property_readonly("nbytes", &Buffer::bytes)
      .def_property_readonly(
          "opencl_handle", [](const Buffer& buffer) { return address(buffer.opencl_handle()); },
          "cl_mem as an int; None where the device is not an OpenCL one")
      .def("write", &write_buffer, py::arg("array"), py::arg("offset") = 0)
      .def("read", &read_buffer, py::arg("array"), py::arg("offset") = 0);

  py::class_<Device, std::shared_ptr<Device>>(module, "Device", "An open device.")
      .def_property_readonly("info", &Device::info, py::return_value_policy::copy)
      .def_property_readonly("prefers_vector_rows", &Device::prefers_vector_rows)
      .def(
          "preferred_lanes",
          [](const Device& device, bool is_double) {
            return device.preferred_lanes(is_double ? Precision::kDouble : Precision::kSingle);
          },
          py::kw_only(), py::arg("is_double"))
      .def_property_readonly(
          "opencl_context",
          [](const Device& device) {
            const auto* opencl = as_opencl(device);
            return address(opencl ? opencl->context_handle() : nullptr);
          },
          "cl_context as an int; None where the device is not an OpenCL one")
      .def_property_readonly(
          "opencl_queue",
          [](const Device& device) {
            const auto* opencl = as_opencl(device);
            return address(opencl ? opencl->queue_handle() : nullptr);
          },
          "cl_command_queue as an int; None where the device is not an OpenCL one")
      .def("finish", &Device::finish, ReleaseGil())
      .def("_allocate", &Device::allocate, py::arg("nbytes"), ReleaseGil())
      .def("_launch", &launch, py::arg("kernel"), py::arg("arguments"), py::arg("n_items"),
           py::kw_only(), py::arg("precision") = "single", py::arg("lanes") = 16,
           py::arg("vector_rows") = true, py::arg("local_size") = 0);

  module.def("all_devices", &all_devices, ReleaseGil(), "Every device, native first, probed.");
  module.def("open_device", &open_device, py::arg("spec"), ReleaseGil(),
             "Opens \"auto\", \"native\", \"opencl\" or \"opencl:N\"; InputError where it cannot.");
  module.def("device_from_handle", &make_opencl_device_from_handle, py::arg("cl_device_id"),
             ReleaseGil(), "Opens the device of a cl_device_id (pyopencl.Device.int_ptr).");
  module.def("opencl_loader_report", &opencl_loader_report, ReleaseGil(),
             "Where the OpenCL library came from, or what was looked for; one line.");
  module.def("add_opencl_library", &add_opencl_library, py::arg("path"),
             "A library to try where the system has none, or none with a driver; call it before "
             "devices are first listed.");
  module.def("set_kernel_folder", &set_kernel_folder, py::arg("path"),
             "The folder of program.cl; TLEDFACE_KERNELS overrides it.");
  module.def("thread_count", &thread_count, "Threads of the native device.");
  module.def(
      "compiler", [] { return TLEDFACE_COMPILER; },
      "The compiler that this module was built with.");
}
