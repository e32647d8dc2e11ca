// Blocks, links, shared row sets and masses: see solver_arrays.hpp and kernels_cl/layout.cl.
#include "precompute/solver_arrays.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_map>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/law_entries.hpp"
#include "precompute/law_table.hpp"
#include "precompute/layout.hpp"
#include "precompute/row_sets.hpp"

namespace tledface {
namespace {

using Key = std::uint64_t;

constexpr int kKeyBits = 20;  // of each of lane-block, y and z
constexpr std::int32_t kLargestIndex = (1 << kKeyBits) - 2;

// Blocks are stored chunk by chunk in x, then row by row in y, then plane by plane in z.
Key block_key(std::int32_t chunk, std::int32_t y, std::int32_t z) {
  return (Key(chunk) << (2 * kKeyBits)) | (Key(y) << kKeyBits) | Key(z);
}

// The fast axis is the one that needs fewest blocks of lanes, the band axis the longer one left.
std::array<int, 3> choose_axis_order(const VoxelModel& model, int lanes) {
  std::array<std::int32_t, 3> extent{};
  for (std::size_t i = 0; i < model.cells.size(); ++i)
    extent[i % 3] = std::max(extent[i % 3], model.cells[i] + 1);
  std::array<std::size_t, 3> n_blocks{};
  std::vector<Key> keys(model.n_elements());
  for (int fast = 0; fast < 3; ++fast) {
    const int a = fast == 0 ? 1 : 0, b = fast == 2 ? 1 : 2;
    for (std::size_t e = 0; e < keys.size(); ++e)
      keys[e] = block_key(model.cells[3 * e + fast] / lanes, model.cells[3 * e + a],
                          model.cells[3 * e + b]);
    std::sort(keys.begin(), keys.end());
    n_blocks[fast] = static_cast<std::size_t>(std::unique(keys.begin(), keys.end()) - keys.begin());
  }
  const int fast =
      static_cast<int>(std::min_element(n_blocks.begin(), n_blocks.end()) - n_blocks.begin());
  int band = fast == 0 ? 1 : 0, march = fast == 2 ? 1 : 2;
  if (extent[march] > extent[band]) std::swap(band, march);
  return {fast, band, march};
}

void check(const VoxelModel& model) {
  const std::size_t n = model.n_elements();
  if (n == 0) throw InputError("model: it has no element; nothing can be simulated");
  if (model.mu.size() != n || model.bulk_log.size() != n || model.bulk_quadratic.size() != n ||
      model.density.size() != n || model.shear_modulus.size() != n ||
      model.bulk_modulus.size() != n || model.bending_modulus.size() != 3 * n ||
      model.fixed.size() != model.node_ijk.size())
    throw InputError("model: arrays of elements or nodes differ in length");
  for (const std::int32_t index : model.cells)
    if (index < 0 || index > kLargestIndex)
      throw InputError("model: grid index " + std::to_string(index) + ", allowed is 0 to " +
                       std::to_string(kLargestIndex));
  for (std::size_t e = 0; e < n; ++e)
    if (!(model.shear_modulus[e] > 0) || !(model.bulk_modulus[e] > 0) || !(model.density[e] > 0))
      throw InputError("model: element " + std::to_string(e) +
                       " has a shear modulus, bulk modulus or density that is not positive");
}

std::array<std::int32_t, 3> permuted(const std::int32_t* ijk, const std::array<int, 3>& order) {
  return {ijk[order[0]], ijk[order[1]], ijk[order[2]]};
}

}  // namespace

SolverArrays make_solver_arrays(const VoxelModel& model, const PrecomputeOptions& options) {
  check(model);
  SolverArrays arrays;
  const int lanes = arrays.lanes = options.lanes;
  const auto order = arrays.order =
      options.axis_order[0] >= 0 ? options.axis_order : choose_axis_order(model, lanes);
  const std::size_t n_elements = model.n_elements(), n_nodes = model.n_nodes();
  const double h[3] = {model.voxel[order[0]], model.voxel[order[1]], model.voxel[order[2]]};
  const double volume = h[0] * h[1] * h[2];

  // Blocks, in the order of their keys.
  std::vector<Key> keys(n_nodes);
  for (std::size_t n = 0; n < n_nodes; ++n) {
    const auto p = permuted(&model.node_ijk[3 * n], order);
    keys[n] = block_key(p[0] / lanes, p[1], p[2]);
  }
  std::vector<Key> sorted = keys;
  std::sort(sorted.begin(), sorted.end());
  sorted.erase(std::unique(sorted.begin(), sorted.end()), sorted.end());
  if (sorted.size() > std::size_t(std::numeric_limits<std::int32_t>::max() / 64))
    throw InputError("model: " + std::to_string(n_nodes) +
                     " nodes are more than the solver can index");
  const std::int32_t n_blocks = arrays.n_blocks = static_cast<std::int32_t>(sorted.size());
  std::unordered_map<Key, std::int32_t> index;
  index.reserve(sorted.size());
  for (std::int32_t b = 0; b < n_blocks; ++b) index.emplace(sorted[b], b);
  const auto find = [&](std::int32_t chunk, std::int32_t y, std::int32_t z) {
    if (chunk < 0 || y < 0 || z < 0) return n_blocks;
    const auto it = index.find(block_key(chunk, y, z));
    return it == index.end() ? n_blocks : it->second;
  };

  arrays.node_slot.resize(n_nodes);
  for (std::size_t n = 0; n < n_nodes; ++n)
    arrays.node_slot[n] =
        std::int64_t(index.at(keys[n])) * lanes + model.node_ijk[3 * n + order[0]] % lanes;
  arrays.element_slot.resize(n_elements);
  for (std::size_t e = 0; e < n_elements; ++e) {
    const auto p = permuted(&model.cells[3 * e], order);
    const std::int32_t block = find(p[0] / lanes, p[1], p[2]);
    if (block == n_blocks)
      throw InputError("model: element " + std::to_string(e) + " has no node at its low corner");
    arrays.element_slot[e] = std::int64_t(block) * lanes + p[0] % lanes;
  }

  // Links.
  constexpr Key mask = (Key(1) << kKeyBits) - 1;
  arrays.blocks.assign(std::size_t(n_blocks + 1) * TLED_BLOCK_INTS, 0);
  arrays.block_at.resize(n_blocks);
  std::int32_t lowest_plane = std::numeric_limits<std::int32_t>::max();
  for (const Key key : sorted) lowest_plane = std::min(lowest_plane, std::int32_t(key & mask));
  for (std::int32_t b = 0; b <= n_blocks; ++b) {
    std::int32_t* links = &arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS];
    links[BLOCK_MATERIAL] = -1;
    for (const int link :
         {BLOCK_NEXT_X, BLOCK_NEXT_Y, BLOCK_NEXT_Z, BLOCK_PREV_X, BLOCK_PREV_Y, BLOCK_PREV_Z})
      links[link] = n_blocks;
    if (b == n_blocks) break;
    const std::int32_t x = std::int32_t(sorted[b] >> (2 * kKeyBits)),
                       y = std::int32_t((sorted[b] >> kKeyBits) & mask),
                       z = std::int32_t(sorted[b] & mask);
    arrays.block_at[b] = {x, y, z};
    links[BLOCK_NEXT_X] = find(x + 1, y, z);
    links[BLOCK_NEXT_Y] = find(x, y + 1, z);
    links[BLOCK_NEXT_Z] = find(x, y, z + 1);
    links[BLOCK_PREV_X] = find(x - 1, y, z);
    links[BLOCK_PREV_Y] = find(x, y - 1, z);
    links[BLOCK_PREV_Z] = find(x, y, z - 1);
    links[BLOCK_HAS_NEXT_X] = links[BLOCK_NEXT_X] != n_blocks;
    links[BLOCK_PLANE] = z - lowest_plane;
  }

  // Elements of each block, in lane order.
  std::vector<std::int64_t> element_at(std::size_t(n_blocks) * lanes, -1);
  for (std::size_t e = 0; e < n_elements; ++e) {
    std::int64_t& at = element_at[arrays.element_slot[e]];
    if (at >= 0)
      throw InputError("model: elements " + std::to_string(at) + " and " + std::to_string(e) +
                       " are the same voxel");
    at = static_cast<std::int64_t>(e);
  }
  RowSets materials(std::size_t(TLED_MATERIAL_ROWS) * lanes, arrays.materials);
  std::vector<double> set(std::size_t(TLED_MATERIAL_ROWS) * lanes);
  double kappa_factor = 0;  // k = kappa (lambda + 2 mu) V/16 sum 1/h^2
  for (const double side : h) kappa_factor += options.kappa * volume / 16 / (side * side);
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    bool has_element = false;
    std::fill(set.begin(), set.end(), 0.0);
    for (int lane = 0; lane < lanes; ++lane) {
      const std::int64_t e = element_at[std::size_t(b) * lanes + lane];
      if (e < 0) continue;
      has_element = true;
      const double mu = model.shear_modulus[e], bulk = model.bulk_modulus[e];
      const double nu = (3 * bulk - 2 * mu) / (2 * (3 * bulk + mu));
      const double youngs_modulus = 9 * bulk * mu / (3 * bulk + mu);
      const auto put = [&](int row, double value) { set[std::size_t(row) * lanes + lane] = value; };
      put(MATERIAL_PRESENT, 1);
      put(MATERIAL_MU, model.mu[e]);
      put(MATERIAL_BULK_LOG_HALF, model.bulk_log[e] / 2);
      put(MATERIAL_BULK_QUADRATIC, model.bulk_quadratic[e]);
      if (options.hourglass == HourglassForm::kPhysical) {
        put(MATERIAL_NU, nu);
        for (int axis = 0; axis < 3; ++axis)
          put(MATERIAL_BEND_X + axis,
              volume / 3 * model.bending_modulus[3 * e + order[axis]] / (1 - nu * nu));
        put(MATERIAL_TWIST, volume / 3 * mu);
        put(MATERIAL_XYZ, volume / 9 * youngs_modulus);
      } else {
        put(MATERIAL_KAPPA, kappa_factor * (bulk + 4 * mu / 3));
      }
    }
    if (!has_element) continue;
    arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_MATERIAL] = materials.add(set);
    ++arrays.n_element_blocks;
  }

  add_laws(model, arrays);

  // Masses and fixed components.
  arrays.node_mass.assign(n_nodes, 0);
  std::vector<double> slot_mass(std::size_t(n_blocks + 1) * lanes, 0.0);
  for (std::size_t e = 0; e < n_elements; ++e) {
    const double share = model.density[e] * volume / 8;
    for (int corner = 0; corner < 8; ++corner) slot_mass[arrays.corner_slot(e, corner)] += share;
  }
  std::vector<double> inverse(std::size_t(n_blocks) * TLED_NODE_ROWS * lanes, 0.0);
  for (std::size_t n = 0; n < n_nodes; ++n) {
    const std::int64_t slot = arrays.node_slot[n], block = slot / lanes, lane = slot % lanes;
    const double mass = arrays.node_mass[n] = slot_mass[slot];
    if (!(mass > 0))
      throw InputError("model: node " + std::to_string(n) + " belongs to no element");
    for (int c = 0; c < 3; ++c)
      if (!model.fixed[3 * n + order[c]])
        inverse[(block * TLED_NODE_ROWS + c) * lanes + lane] = 1 / mass;
  }
  RowSets node_sets(std::size_t(TLED_NODE_ROWS) * lanes, arrays.node_sets);
  std::vector<double> node_set(std::size_t(TLED_NODE_ROWS) * lanes);
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    const auto begin = inverse.begin() + std::ptrdiff_t(b) * TLED_NODE_ROWS * lanes;
    std::copy(begin, begin + TLED_NODE_ROWS * lanes, node_set.begin());
    arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_NODE] = node_sets.add(node_set);
  }

  // Muscles: per block and muscle one row set.
  struct Fibre {
    std::int64_t slot;
    std::int32_t muscle;
    std::int64_t at;
  };
  std::vector<Fibre> fibres;
  for (std::size_t m = 0; m < model.muscles.size(); ++m) {
    const VoxelMuscle& muscle = model.muscles[m];
    for (std::size_t i = 0; i < muscle.elements.size(); ++i) {
      const std::int64_t e = muscle.elements[i];
      if (e < 0 || e >= static_cast<std::int64_t>(n_elements))
        throw InputError("muscle '" + muscle.name + "': element " + std::to_string(e) +
                         " does not exist");
      fibres.push_back(
          {arrays.element_slot[e], static_cast<std::int32_t>(m), static_cast<std::int64_t>(i)});
    }
    const double lo = muscle.lambda_opt, at_line = std::exp(6.6 * (muscle.lambda_pas - 1));
    const double line =
        muscle.printed_passive ? 2.18 * muscle.lambda_pas - 2.47 : 0.05 * (at_line - 1);
    const double constants[TLED_MUSCLE_CONSTANTS] = {
        muscle.sigma_act,           -25 / (4 * lo * lo), 25 / (2 * lo),
        muscle.sigma_pas,           muscle.lambda_pas,   line,
        muscle.calcium ? 1.0 : 0.0, muscle.beta};
    arrays.muscle_constants.insert(arrays.muscle_constants.end(), std::begin(constants),
                                   std::end(constants));
  }
  std::sort(fibres.begin(), fibres.end(), [&](const Fibre& a, const Fibre& b) {
    const std::int64_t block_a = a.slot / lanes, block_b = b.slot / lanes;
    if (block_a != block_b) return block_a < block_b;
    if (a.muscle != b.muscle) return a.muscle < b.muscle;
    return a.slot < b.slot;
  });
  RowSets muscle_sets(std::size_t(TLED_MUSCLE_ROWS) * lanes, arrays.muscle_sets);
  std::vector<double> muscle_set(std::size_t(TLED_MUSCLE_ROWS) * lanes);
  for (std::size_t i = 0; i < fibres.size();) {
    const std::int64_t block = fibres[i].slot / lanes;
    std::int32_t* links = &arrays.blocks[block * TLED_BLOCK_INTS];
    links[BLOCK_MUSCLE_BEGIN] = static_cast<std::int32_t>(arrays.muscle_entries.size() / 2);
    while (i < fibres.size() && fibres[i].slot / lanes == block) {
      const std::int32_t muscle = fibres[i].muscle;
      std::fill(muscle_set.begin(), muscle_set.end(), 0.0);
      for (; i < fibres.size() && fibres[i].slot / lanes == block && fibres[i].muscle == muscle;
           ++i) {
        const VoxelMuscle& source = model.muscles[muscle];
        const std::int64_t lane = fibres[i].slot % lanes;
        for (int c = 0; c < 3; ++c)
          muscle_set[c * lanes + lane] = source.fibre[3 * fibres[i].at + order[c]];
        muscle_set[3 * lanes + lane] = source.weight[fibres[i].at];
      }
      arrays.muscle_entries.push_back(muscle);
      arrays.muscle_entries.push_back(muscle_sets.add(muscle_set));
    }
    links[BLOCK_MUSCLE_END] = static_cast<std::int32_t>(arrays.muscle_entries.size() / 2);
  }

  arrays.shape.assign(TLED_SHAPE_REALS, 0.0);
  for (int d = 0; d < 3; ++d) {
    arrays.shape[SHAPE_GRADIENT + d] = 1 / (4 * h[d]);
    arrays.shape[SHAPE_FORCE + d] = volume / (4 * h[d]);
  }
  arrays.shape[SHAPE_RATIO_XY] = h[0] / h[1];
  arrays.shape[SHAPE_RATIO_YX] = h[1] / h[0];
  arrays.shape[SHAPE_RATIO_YZ] = h[1] / h[2];
  arrays.shape[SHAPE_RATIO_ZY] = h[2] / h[1];
  arrays.shape[SHAPE_RATIO_ZX] = h[2] / h[0];
  arrays.shape[SHAPE_RATIO_XZ] = h[0] / h[2];
  return arrays;
}

std::int64_t SolverArrays::corner_slot(std::size_t element, int corner) const {
  std::int64_t block = element_slot[element] / lanes, lane = element_slot[element] % lanes;
  if (corner & 2) block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_Y];
  if (corner & 4) block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_Z];
  if ((corner & 1) && ++lane == lanes) {
    block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_X];
    lane = 0;
  }
  return block * lanes + lane;
}

std::vector<double> history_in_layout(const VoxelModel& model, const SolverArrays& from,
                                      const std::vector<double>& rows, const SolverArrays& to) {
  std::vector<double> result(std::size_t(to.n_history_rows) * to.lanes, 0.0);
  for (std::size_t spec = 0; spec < model.laws.size(); ++spec) {
    const int history = law_info(law_number(model.laws[spec].name)).history;
    for (std::size_t i = 0; i < to.history_slot[spec].size(); ++i)
      for (int row = 0; row < history; ++row)
        result[to.history_slot[spec][i] + std::int64_t(row) * to.lanes] =
            rows[from.history_slot[spec][i] + std::int64_t(row) * from.lanes];
  }
  return result;
}

std::vector<double> slots_to_nodes(const SolverArrays& arrays, const std::vector<double>& slots) {
  const std::size_t n = arrays.node_slot.size(), lanes = arrays.lanes;
  std::vector<double> nodes(3 * n);
  parallel_for_chunks(n, 16384, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t slot = arrays.node_slot[i], block = slot / lanes, lane = slot % lanes;
      for (int c = 0; c < 3; ++c)
        nodes[3 * i + arrays.order[c]] = slots[(block * 3 + c) * lanes + lane];
    }
  });
  return nodes;
}

std::vector<double> nodes_to_slots(const SolverArrays& arrays, const std::vector<double>& nodes) {
  const std::size_t n = arrays.node_slot.size(), lanes = arrays.lanes;
  if (nodes.size() != 3 * n)
    throw InputError("nodal array: " + std::to_string(3 * n) + " values are needed, got " +
                     std::to_string(nodes.size()));
  std::vector<double> slots(std::size_t(arrays.n_blocks + 1) * lanes * 3, 0.0);
  parallel_for_chunks(n, 16384, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t slot = arrays.node_slot[i], block = slot / lanes, lane = slot % lanes;
      for (int c = 0; c < 3; ++c)
        slots[(block * 3 + c) * lanes + lane] = nodes[3 * i + arrays.order[c]];
    }
  });
  return slots;
}

double SolverArrays::fill() const {
  return static_cast<double>(element_slot.size()) / static_cast<double>(n_element_blocks * lanes);
}

}  // namespace tledface
