#include "backend/opencl/loader.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>

#include "backend/device.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

constexpr const char* kSystemLibrary = "libOpenCL.so.1";
constexpr const char* kNvidiaDriver = "libnvidia-opencl.so.1";
// The empty folder leaves the search to the dynamic linker.
constexpr const char* kDriverFolders[] = {"",
                                          "/usr/lib/x86_64-linux-gnu/",
                                          "/usr/lib/aarch64-linux-gnu/",
                                          "/usr/lib64/",
                                          "/usr/local/nvidia/lib64/",
                                          "/usr/local/nvidia/lib/",
                                          "/usr/lib/wsl/lib/",
                                          "/run/opengl-driver/lib/"};

std::string linker_error() {
  const char* text = dlerror();
  return text ? text : "unknown error";
}

// Entry points of an open library; false and `error` where one is missing.
bool read_entry_points(void* library, cl::Api& api, std::string& error) {
  std::string missing;
#define TLEDFACE_CL_FIND(name, result, arguments)                              \
  api.name = reinterpret_cast<decltype(api.name)>(dlsym(library, "cl" #name)); \
  if (!api.name && missing.empty()) missing = "cl" #name;
  TLEDFACE_CL_ENTRY_POINTS(TLEDFACE_CL_FIND)
#undef TLEDFACE_CL_FIND
  if (!missing.empty()) error = "has no " + missing;
  return missing.empty();
}

// Paths of mapped files named libOpenCL*.so*: wheels rename the loader they ship.
std::vector<std::string> mapped_libraries() {
  std::vector<std::string> paths;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    const auto start = line.find('/');
    if (start == std::string::npos) continue;
    const std::string path = line.substr(start);
    const std::string name = path.substr(path.rfind('/') + 1);
    if (name.rfind("libOpenCL", 0) != 0 || name.find(".so") == std::string::npos) continue;
    if (std::find(paths.begin(), paths.end(), path) == paths.end()) paths.push_back(path);
  }
  return paths;
}

std::vector<cl::Platform> platforms_of(const cl::Api& api) {
  cl::UInt count = 0;
  if (api.GetPlatformIDs(0, nullptr, &count) != cl::kSuccess || count == 0) return {};
  std::vector<cl::Platform> platforms(count);
  if (api.GetPlatformIDs(count, platforms.data(), nullptr) != cl::kSuccess) return {};
  return platforms;
}

// The loader in pyopencl's wheel takes the package's folder from PYOPENCL_HOME, which importing
// pyopencl sets, and crashes without it.
void set_pyopencl_home(const std::string& library) {
  const auto folder = std::filesystem::path(library).parent_path();
  if (folder.filename() == ".libs" && folder.parent_path().filename() == "pyopencl")
    setenv("PYOPENCL_HOME", folder.parent_path().c_str(), 0);
}

// The file that the entry points came from.
std::string path_of(const cl::Api& api) {
  Dl_info info;
  if (!dladdr(reinterpret_cast<void*>(api.GetPlatformIDs), &info) || !info.dli_fname) return "?";
  return info.dli_fname;
}

class Loader {
 public:
  const cl::Api* api() {
    std::lock_guard<std::mutex> lock(mutex_);
    search_once();
    return found_ ? &api_ : nullptr;
  }

  const std::vector<cl::Platform>& platforms() {
    std::lock_guard<std::mutex> lock(mutex_);
    search_once();
    return platforms_;
  }

  std::string report() {
    std::lock_guard<std::mutex> lock(mutex_);
    search_once();
    return report_;
  }

  void add(const std::string& path) {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!searched_ && std::find(extra_.begin(), extra_.end(), path) == extra_.end())
      extra_.push_back(path);
  }

 private:
  void search_once() {
    if (searched_) return;
    searched_ = true;
    find_library();
    if (!found_) return;
    platforms_ = platforms_of(api_);
    if (platforms_.empty()) report_ += "; it lists no platform (no driver is registered)";
    add_unregistered_nvidia();
  }

  void find_library() {
    std::string error;
    if (const char* path = std::getenv("TLEDFACE_OPENCL_LIBRARY"); path && *path) {
      if (open(path, RTLD_NOW | RTLD_LOCAL, error))
        report_ = std::string(path) + " (TLEDFACE_OPENCL_LIBRARY)";
      else
        report_ = "none: TLEDFACE_OPENCL_LIBRARY=" + std::string(path) + " cannot be used (" +
                  error + "); correct the path or unset it";
      return;
    }
    std::vector<std::string> loaded = mapped_libraries();
    loaded.insert(loaded.begin(), kSystemLibrary);
    for (const auto& path : loaded) {
      if (!open(path, RTLD_NOW | RTLD_LOCAL | RTLD_NOLOAD, error)) continue;
      report_ = path_of(api_) + " (already in the process)";
      return;
    }
    std::vector<std::string> candidates = extra_;
    candidates.insert(candidates.begin(), kSystemLibrary);
    cl::Api first;
    std::string tried;
    for (const auto& path : candidates) {
      if (!open(path, RTLD_NOW | RTLD_LOCAL, error)) {
        tried += "; " + error;
        continue;
      }
      if (!first.GetPlatformIDs) first = api_;
      // A wheel's loader can know drivers of its own where the system's knows none.
      if (!platforms_of(api_).empty()) {
        report_ = path_of(api_);
        return;
      }
    }
    if (found_) {
      api_ = first;
      report_ = path_of(api_);
    } else {
      report_ = "none: no libOpenCL in the process" + tried;
    }
  }

  bool open(const std::string& path, int flags, std::string& error) {
    void* library = dlopen(path.c_str(), flags);
    if (!library) {
      error = linker_error();
      return false;
    }
    cl::Api candidate;
    if (!read_entry_points(library, candidate, error)) {
      error = path + " " + error;
      dlclose(library);
      return false;
    }
    set_pyopencl_home(path);
    api_ = candidate;
    found_ = true;
    return true;
  }

  void add_unregistered_nvidia() {
    for (const auto platform : platforms_) {
      char vendor[256] = {};
      api_.GetPlatformInfo(platform, cl::kPlatformVendor, sizeof vendor - 1, vendor, nullptr);
      if (std::string(vendor).find("NVIDIA") != std::string::npos) return;
    }
    for (const char* folder : kDriverFolders) {
      const std::string path = std::string(folder) + kNvidiaDriver;
      try {
        const auto unregistered = platforms_of_driver(path);
        if (unregistered.empty()) continue;
        platforms_.insert(platforms_.end(), unregistered.begin(), unregistered.end());
        report_ += "; NVIDIA's driver is not registered, used directly from " + path;
        return;
      } catch (const InputError&) {
        continue;  // not in this folder
      }
    }
  }

  std::mutex mutex_;
  bool searched_ = false, found_ = false;
  cl::Api api_;
  std::vector<cl::Platform> platforms_;
  std::vector<std::string> extra_;
  std::string report_;
};

// Never destroyed: drivers tear themselves down at exit in an order nobody controls.
Loader& loader() {
  static Loader* instance = new Loader;
  return *instance;
}

}  // namespace

const cl::Api* opencl_api() { return loader().api(); }

const std::vector<cl::Platform>& opencl_platforms() { return loader().platforms(); }

void add_opencl_library(const std::string& path) { loader().add(path); }

std::string opencl_loader_report() { return loader().report(); }

// The way an ICD loader itself asks a driver (cl_khr_icd, "Source Code" section of the extension).
std::vector<cl::Platform> platforms_of_driver(const std::string& path) {
  void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!library) throw InputError("OpenCL driver " + path + ": " + linker_error());
  using FindFunction = void* (*)(const char*);
  using ListPlatforms = cl::Int (*)(cl::UInt, cl::Platform*, cl::UInt*);
  const auto find = reinterpret_cast<FindFunction>(dlsym(library, "clGetExtensionFunctionAddress"));
  const auto list =
      find ? reinterpret_cast<ListPlatforms>(find("clIcdGetPlatformIDsKHR")) : nullptr;
  if (!list) {
    dlclose(library);
    throw InputError("OpenCL driver " + path + ": has no clIcdGetPlatformIDsKHR");
  }
  cl::UInt count = 0;
  if (list(0, nullptr, &count) != cl::kSuccess || count == 0) return {};
  std::vector<cl::Platform> platforms(count);
  if (list(count, platforms.data(), nullptr) != cl::kSuccess) return {};
  return platforms;
}

std::string opencl_error_name(cl::Int code) {
  static const std::map<cl::Int, const char*> names = {
      {-1, "CL_DEVICE_NOT_FOUND"},
      {-2, "CL_DEVICE_NOT_AVAILABLE"},
      {-3, "CL_COMPILER_NOT_AVAILABLE"},
      {-4, "CL_MEM_OBJECT_ALLOCATION_FAILURE"},
      {-5, "CL_OUT_OF_RESOURCES"},
      {-6, "CL_OUT_OF_HOST_MEMORY"},
      {-11, "CL_BUILD_PROGRAM_FAILURE"},
      {-14, "CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST"},
      {-30, "CL_INVALID_VALUE"},
      {-33, "CL_INVALID_DEVICE"},
      {-34, "CL_INVALID_CONTEXT"},
      {-36, "CL_INVALID_COMMAND_QUEUE"},
      {-38, "CL_INVALID_MEM_OBJECT"},
      {-43, "CL_INVALID_BUILD_OPTIONS"},
      {-44, "CL_INVALID_PROGRAM"},
      {-45, "CL_INVALID_PROGRAM_EXECUTABLE"},
      {-46, "CL_INVALID_KERNEL_NAME"},
      {-49, "CL_INVALID_ARG_INDEX"},
      {-50, "CL_INVALID_ARG_VALUE"},
      {-51, "CL_INVALID_ARG_SIZE"},
      {-52, "CL_INVALID_KERNEL_ARGS"},
      {-54, "CL_INVALID_WORK_GROUP_SIZE"},
      {-55, "CL_INVALID_WORK_ITEM_SIZE"},
      {-61, "CL_INVALID_BUFFER_SIZE"},
      {-63, "CL_INVALID_GLOBAL_WORK_SIZE"},
      {-1001, "CL_PLATFORM_NOT_FOUND_KHR"},
  };
  const auto found = names.find(code);
  const std::string number = std::to_string(code);
  if (found == names.end()) return "error " + number;
  return std::string(found->second) + " (" + number + ")";
}

}  // namespace tledface
