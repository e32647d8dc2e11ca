#include "precompute/law_entries.hpp"

#include <algorithm>
#include <string>

#include "core/error.hpp"
#include "precompute/law_table.hpp"
#include "precompute/layout.hpp"
#include "precompute/row_sets.hpp"

namespace tledface {

// Entries of every block's laws, sorted by the law's number (stage 1 after stage 0).
void add_laws(const VoxelModel& model, SolverArrays& arrays) {
  struct Use {
    std::int64_t slot;
    std::int32_t law, spec;
    std::int64_t at;
  };
  const int lanes = arrays.lanes;
  std::vector<Use> uses;
  arrays.history_slot.resize(model.laws.size());
  std::vector<RowSets> sets;
  std::vector<std::vector<double>> storage(n_laws());
  for (std::int32_t law = 0; law < n_laws(); ++law)
    sets.emplace_back(std::size_t(law_info(law).rows) * lanes, storage[law]);
  for (std::size_t spec = 0; spec < model.laws.size(); ++spec) {
    const VoxelLaw& source = model.laws[spec];
    const std::int32_t law = law_number(source.name);
    if (source.rows.size() != source.elements.size() * std::size_t(law_info(law).rows))
      throw InputError("law '" + source.name + "': " + std::to_string(law_info(law).rows) +
                       " values an element are needed");
    if (law_info(law).history) arrays.history_slot[spec].resize(source.elements.size());
    for (std::size_t i = 0; i < source.elements.size(); ++i) {
      const std::int64_t e = source.elements[i];
      if (e < 0 || e >= static_cast<std::int64_t>(model.n_elements()))
        throw InputError("law '" + source.name + "': element " + std::to_string(e) +
                         " does not exist");
      uses.push_back({arrays.element_slot[e], law, static_cast<std::int32_t>(spec),
                      static_cast<std::int64_t>(i)});
    }
  }
  std::sort(uses.begin(), uses.end(), [&](const Use& a, const Use& b) {
    const std::int64_t block_a = a.slot / lanes, block_b = b.slot / lanes;
    if (block_a != block_b) return block_a < block_b;
    if (a.law != b.law) return a.law < b.law;
    if (a.spec != b.spec) return a.spec < b.spec;
    return a.slot < b.slot;
  });
  std::vector<double> set;
  for (std::size_t i = 0; i < uses.size();) {
    const std::int64_t block = uses[i].slot / lanes;
    std::int32_t* links = &arrays.blocks[block * TLED_BLOCK_INTS];
    links[BLOCK_LAW_BEGIN] = static_cast<std::int32_t>(arrays.law_entries.size() / TLED_LAW_ENTRY);
    while (i < uses.size() && uses[i].slot / lanes == block) {
      const Use first = uses[i];
      const int rows = law_info(first.law).rows, history = law_info(first.law).history;
      set.assign(std::size_t(rows) * lanes, 0.0);
      for (; i < uses.size() && uses[i].slot / lanes == block && uses[i].law == first.law &&
             uses[i].spec == first.spec;
           ++i) {
        const double* values = &model.laws[first.spec].rows[uses[i].at * rows];
        const std::int64_t lane = uses[i].slot % lanes;
        for (int row = 0; row < rows; ++row) set[std::size_t(row) * lanes + lane] = values[row];
        for (const int vector : law_info(first.law).vectors)
          for (int c = 0; vector && c < 3; ++c)
            set[std::size_t(vector + c) * lanes + lane] = values[vector + arrays.order[c]];
        if (history)
          arrays.history_slot[first.spec][uses[i].at] = arrays.n_history_rows * lanes + lane;
      }
      arrays.law_entries.push_back(first.law);
      arrays.law_entries.push_back(sets[first.law].add(set));
      arrays.law_entries.push_back(history ? static_cast<std::int32_t>(arrays.n_history_rows) : -1);
      arrays.n_history_rows += history;
    }
    links[BLOCK_LAW_END] = static_cast<std::int32_t>(arrays.law_entries.size() / TLED_LAW_ENTRY);
  }
  // One array of sets: each law's begin where the one before ends; entries count rows of lanes.
  std::vector<std::int32_t> begin(n_laws(), 0);
  for (std::int32_t law = 0; law < n_laws(); ++law) {
    begin[law] = static_cast<std::int32_t>(arrays.law_sets.size() / lanes);
    arrays.law_sets.insert(arrays.law_sets.end(), storage[law].begin(), storage[law].end());
  }
  for (std::size_t i = 0; i < arrays.law_entries.size(); i += TLED_LAW_ENTRY) {
    const std::int32_t law = arrays.law_entries[i];
    arrays.law_entries[i + 1] = begin[law] + arrays.law_entries[i + 1] * law_info(law).rows;
  }
}

}  // namespace tledface
