#include "backend/opencl/sources.hpp"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <set>

#include "core/error.hpp"

namespace tledface {
namespace {

namespace fs = std::filesystem;

std::mutex folder_mutex;
std::string& registered_folder() {
#ifdef TLEDFACE_KERNEL_FOLDER
  static std::string folder = TLEDFACE_KERNEL_FOLDER;
#else
  static std::string folder;
#endif
  return folder;
}

fs::path shipped_folder() {
  std::lock_guard<std::mutex> lock(folder_mutex);
  if (registered_folder().empty())
    throw InputError(
        "kernel folder: none is known; set TLEDFACE_KERNELS to the folder of program.cl");
  return registered_folder();
}

fs::path kernel_folder() {
  const char* path = std::getenv("TLEDFACE_KERNELS");
  if (!path || !*path) return shipped_folder();
  if (!fs::is_directory(path))
    throw InputError("TLEDFACE_KERNELS=" + std::string(path) +
                     ": no such folder; give the folder of program.cl, or unset it");
  return path;
}

std::string trimmed(const std::string& line) {
  const auto first = line.find_first_not_of(" \t");
  if (first == std::string::npos) return {};
  return line.substr(first, line.find_last_not_of(" \t\r") - first + 1);
}

// The directive's text behind '#', "" for other lines.
std::string directive(const std::string& line) {
  const std::string text = trimmed(line);
  return !text.empty() && text[0] == '#' ? trimmed(text.substr(1)) : std::string();
}

std::string line_marker(std::size_t line, const fs::path& file) {
  std::string name;
  for (const char c : file.string()) {
    if (c == '"' || c == '\\') name += '\\';
    name += c;
  }
  return "#line " + std::to_string(line) + " \"" + name + "\"\n";
}

class Joiner {
 public:
  explicit Joiner(fs::path folder) : folder_(std::move(folder)) {}

  void append(const fs::path& file, const std::string& included_from) {
    std::ifstream stream(file);
    if (!stream)
      throw InputError("kernel file " + file.string() + ": cannot be read" + included_from +
                       "; check TLEDFACE_KERNELS or reinstall tledface");
    if (!done_.insert(fs::weakly_canonical(file).string()).second) return;
    text_ += line_marker(1, file);
    std::size_t number = 0;
    for (std::string line; std::getline(stream, line);) {
      ++number;
      const std::string what = directive(line);
      if (what.rfind("include", 0) == 0 && what.find('"') != std::string::npos) {
        const auto open = what.find('"');
        const auto close = what.find('"', open + 1);
        const fs::path name = what.substr(open + 1, close - open - 1);
        const fs::path beside = file.parent_path() / name;
        append(fs::exists(beside) ? beside : folder_ / name,
               " (included from " + file.string() + ":" + std::to_string(number) + ")");
        text_ += line_marker(number + 1, file);
      } else if (what == "pragma once") {
        text_ += "\n";
      } else {
        text_ += line + "\n";
      }
    }
  }

  const std::string& text() const { return text_; }

 private:
  fs::path folder_;
  std::set<std::string> done_;
  std::string text_;
};

std::string join(const fs::path& folder, const std::string& file, const ProgramOptions& options) {
  const bool is_double = options.precision == Precision::kDouble;
  std::string prologue = "#define TLED_OPENCL 1\n";
  prologue += "#define TLED_LANES " + std::to_string(options.lanes) + "\n";
  prologue += std::string("#define TLED_VECTOR_ROWS ") + (options.vector_rows ? "1\n" : "0\n");
  // Not for the kernels: programs are told apart by their text.
  if (options.registers)
    prologue += "// at most " + std::to_string(options.registers) + " registers\n";
  prologue += std::string("#define TLED_LAWS ") + (options.laws ? "1\n" : "0\n");
  prologue += std::string("#define TLED_DOUBLE ") + (is_double ? "1\n" : "0\n");
  if (is_double) prologue += "#pragma OPENCL EXTENSION cl_khr_fp64 : enable\n";
  Joiner joiner(folder);
  joiner.append(folder / file, "");
  return prologue + joiner.text();
}

}  // namespace

void set_kernel_folder(const std::string& path) {
  std::lock_guard<std::mutex> lock(folder_mutex);
  registered_folder() = path;
}

std::string kernel_source(const std::string& file, const ProgramOptions& options) {
  return join(kernel_folder(), file, options);
}

std::string shipped_kernel_source(const std::string& file, const ProgramOptions& options) {
  return join(shipped_folder(), file, options);
}

}  // namespace tledface
