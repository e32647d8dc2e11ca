// Which kernels are launched how often and how long they take, for the benchmark. While a log is
// active each launch is waited for, so the sum is a little more than the time without.
#pragma once
#include <chrono>
#include <map>
#include <string>

namespace tledface {

struct LaunchLog {
  struct Entry {
    std::size_t launches = 0;
    double seconds = 0;
  };
  std::map<std::string, Entry> kernels;
};

// Null while nothing is to be kept. One thread at a time.
inline LaunchLog*& active_launch_log() {
  static LaunchLog* log = nullptr;
  return log;
}

// Runs launch() and enters it in the active log; finish() waits for the device.
template <class Launch, class Finish>
void logged_launch(const std::string& kernel, Launch launch, Finish finish) {
  LaunchLog* log = active_launch_log();
  finish();
  const auto begin = std::chrono::steady_clock::now();
  launch();
  finish();
  LaunchLog::Entry& entry = log->kernels[kernel];
  ++entry.launches;
  entry.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace tledface
