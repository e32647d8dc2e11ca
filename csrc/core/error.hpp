// Errors that cross the border to the user. Both carry one complete line.
#pragma once
#include <stdexcept>
#include <string>

namespace tledface {

// The caller gave something that cannot be used: what, what was got, what is allowed, what to do.
class InputError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

// A simulation that cannot go on (a non-finite state, a device that failed while running).
class SimulationError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace tledface
