// A pool of threads that live as long as the process. Each thread takes its own share of the items
// first, the same in every region of as many, then what is left of the others': a thread slowed by
// other load on the machine does not hold the rest up. Nothing that the items compute may depend on
// which thread runs them.
#pragma once
#include <cstddef>
#include <functional>

namespace tledface {

// Threads a parallel region uses: TLEDFACE_NUM_THREADS if set, else the cores this process may use.
std::size_t thread_count();

// Runs body(item) for item in [0, n_items), the caller's thread included; returns when all are
// done. An exception in a body is rethrown here (the first one). Calls from inside a body run
// serially.
void parallel_for(std::size_t n_items, const std::function<void(std::size_t)>& body);

// As above with chunks: body(begin, end), chunks of at most `grain` items.
void parallel_for_chunks(std::size_t n_items, std::size_t grain,
                         const std::function<void(std::size_t, std::size_t)>& body);

// Regions use at most this many threads from now on (0: all), so that one process can compare: the
// results are the same, thread_count() too.
void limit_threads(std::size_t most);

}  // namespace tledface
