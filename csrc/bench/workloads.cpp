#include "bench/workloads.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include "bench/block_model.hpp"
#include "core/error.hpp"
#include "model/nearest_surface.hpp"

namespace tledface::bench {
namespace {

// Of the face: columns of 4.76 voxels over a bone with triangles of 1.7 mm, thrown at the pace of a
// brow that rises 12 mm in 10 000 steps.
constexpr double kFaceThickness = 4.76 * kVoxel, kGap = 0.25e-3, kTriangle = 1.7e-3, kRim = 20e-3,
                 kBrowSpeed = 1.2e-6;
constexpr int kFaceColumns = 325, kShellThickness = 5;
constexpr std::size_t kFaceElements = 503452, kFigureElements = 15107;
constexpr double kActivation = 0.3;

using Height = std::function<double(double, double)>;

// A vault with two brows and some unevenness, m.
double bone_height(double x, double y) {
  const auto square = [](double a) { return a * a; };
  double height = -(x * x + y * y) / (2 * 0.8);
  for (const double at : {-25e-3, 25e-3})
    height += 1.5e-3 * std::exp(-square((x - at) / 20e-3) - square((y + 20e-3) / 6e-3));
  return height + 0.1e-3 * std::sin(x / 2.1e-3) * std::sin(y / 2.7e-3);
}

TriangleMesh bone(double width) {
  const int n = std::max(2, static_cast<int>(std::lround((width + kRim) / kTriangle)));
  const double edge = (width + kRim) / n;
  TriangleMesh mesh;
  for (int i = 0; i <= n; ++i)
    for (int j = 0; j <= n; ++j) {
      const double x = i * edge - (width + kRim) / 2, y = j * edge - (width + kRim) / 2;
      mesh.vertices.push_back({x, y, bone_height(x, y)});
    }
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const std::int32_t a = i * (n + 1) + j, b = a + n + 1, c = b + 1, d = a + 1;
      mesh.faces.push_back({a, b, c});
      mesh.faces.push_back({a, c, d});
    }
  return mesh;
}

// A shell of n x n columns of voxels between two heights: layers of skin from above, muscle in the
// second voxel from below and, in a belt over the middle third, in the lowest. Nodes stand column
// by column.
struct Shell {
  VoxelModel model;
  std::vector<std::int64_t> lowest;  // nodes under the lowest voxels
  int low = 0;                       // grid plane 0 over the frame's origin, in voxels
};

Shell shell(int n, const Height& under, const Height& over) {
  std::vector<int> bottom(std::size_t(n) * n), top(bottom.size());
  const auto centre = [n](int i) { return (i + 0.5 - n / 2.0) * kVoxel; };
  Shell result;
  std::size_t n_elements = 0;
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const std::size_t c = std::size_t(j) * n + i;
      bottom[c] = static_cast<int>(std::ceil(under(centre(i), centre(j)) / kVoxel - 0.5));
      top[c] = static_cast<int>(std::ceil(over(centre(i), centre(j)) / kVoxel - 0.5));
      n_elements += std::size_t(top[c] - bottom[c]);
    }
  const int low = result.low = *std::min_element(bottom.begin(), bottom.end());
  VoxelModel& model = result.model;
  model.voxel = {kVoxel, kVoxel, kVoxel};
  reserve(model, n_elements);
  VoxelMuscle muscle = frontalis();
  const Moduli skin = Moduli().add(0.04, kCorneum).add(0.96, kDermis),
               dermis = Moduli().add(1, kDermis), fat = Moduli().add(1, kHypodermis),
               fibres = Moduli().add(1, kMuscle);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const std::size_t c = std::size_t(j) * n + i;
      for (int k = bottom[c]; k < top[c]; ++k) {
        const int up = k - bottom[c], down = top[c] - 1 - k;
        const bool in_muscle = up == 1 || (up == 0 && j >= n / 3 && j < n - n / 3);
        if (in_muscle) add_fibre(muscle, model.n_elements(), 0, 1, 0);
        const Moduli& moduli = in_muscle ? fibres : down == 0 ? skin : down < 3 ? dermis : fat;
        add_element(model, i, j, k - low, moduli, 11000);
      }
    }
  model.muscles.push_back(std::move(muscle));
  // The nodes of a column: from the lowest voxel about it to the highest.
  std::vector<std::uint8_t> is_lowest;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      int from = 1 << 30, to = -(1 << 30);
      const auto about = [&](auto&& visit) {
        for (int b = std::max(0, j - 1); b <= std::min(n - 1, j); ++b)
          for (int a = std::max(0, i - 1); a <= std::min(n - 1, i); ++a)
            visit(std::size_t(b) * n + a);
      };
      about([&](std::size_t c) { from = std::min(from, bottom[c]), to = std::max(to, top[c]); });
      const auto first = static_cast<std::int64_t>(model.n_nodes());
      for (int k = from; k <= to; ++k) {
        model.node_ijk.insert(model.node_ijk.end(), {i, j, k - low});
        model.fixed.insert(model.fixed.end(), {0, 0, 0});
      }
      is_lowest.assign(std::size_t(to - from + 1), 0);
      about([&](std::size_t c) { is_lowest[std::size_t(bottom[c] - from)] = 1; });
      for (std::size_t k = 0; k < is_lowest.size(); ++k)
        if (is_lowest[k]) result.lowest.push_back(first + static_cast<std::int64_t>(k));
    }
  return result;
}

Workload face(std::size_t elements) {
  const int n = std::max(
      8, static_cast<int>(std::lround(kFaceColumns * std::sqrt(double(elements) / kFaceElements))));
  const double width = n * kVoxel;
  Shell body = shell(
      n, [](double x, double y) { return bone_height(x, y) + kGap; },
      [](double x, double y) { return bone_height(x, y) + kGap + kFaceThickness; });
  Workload result;
  result.sliding.surfaces.push_back(weld(bone(width), 0));
  // The model's frame has its origin at the grid's.
  for (auto& vertex : result.sliding.surfaces[0].vertices) {
    vertex.x += width / 2;
    vertex.y += width / 2;
    vertex.z -= body.low * kVoxel;
  }
  std::vector<Vec3> points;
  for (const auto node : body.lowest) {
    const auto p = body.model.position(static_cast<std::size_t>(node));
    points.push_back({p[0], p[1], p[2]});
  }
  const auto nearest = nearest_surfaces(result.sliding.surfaces, points, 0);
  result.sliding.nodes = std::move(body.lowest);
  result.sliding.surface.assign(nearest.size(), 0);
  for (const auto& n_found : nearest) result.sliding.distance.push_back(n_found.distance);
  result.model = std::move(body.model);
  result.speed = kBrowSpeed;
  return result;
}

Workload sparse_shell(std::size_t elements) {
  const int n = std::max(8, static_cast<int>(std::lround(std::sqrt(elements / kShellThickness))));
  // A vault as steep as 0.7 at its corners.
  const double radius = n * kVoxel;
  const auto height = [radius](double x, double y) { return -(x * x + y * y) / (2 * radius); };
  Shell body = shell(n, height, [&](double x, double y) {
    // The same rounding as `under`: five voxels everywhere.
    return height(x, y) + kShellThickness * kVoxel;
  });
  Workload result;
  result.model = std::move(body.model);
  VoxelModel& model = result.model;
  for (std::size_t node = 0; node < model.n_nodes(); ++node) {
    const std::int32_t* ijk = &model.node_ijk[3 * node];
    const bool rim = ijk[0] == 0 || ijk[0] == n || ijk[1] == 0 || ijk[1] == n;
    std::fill_n(&model.fixed[3 * node], 3, std::uint8_t(rim));
  }
  return result;
}

// Trunk, head, arms that hang away from it and legs, of ellipsoids, its trunk held.
Workload figure(std::size_t elements) {
  struct Ellipsoid {
    double x, y, z, rx, ry, rz;
  };
  const Ellipsoid parts[] = {{0, 0, 0.62, .19, .15, .24},     {0, 0, 0.93, .11, .13, .13},
                             {.30, 0, 0.74, .20, .075, .08},  {-.30, 0, 0.74, .20, .075, .08},
                             {.50, .08, 0.76, .08, .16, .08}, {-.50, .08, 0.76, .08, .16, .08},
                             {.13, 0, 0.22, .10, .11, .25},   {-.13, 0, 0.22, .10, .11, .25},
                             {.14, -.1, 0.05, .09, .18, .06}, {-.14, -.1, 0.05, .09, .18, .06},
                             {0, .22, 0.42, .07, .26, .07}};
  // Voxels a metre of the figure's height, so that there are about as many as asked for.
  const double per_unit = 56.1 * std::cbrt(double(elements) / kFigureElements);
  const int n = static_cast<int>(std::ceil(1.2 * per_unit));
  const auto inside = [&](int i, int j, int k) {
    const double p[3] = {(i + .5) / per_unit - .6, (j + .5) / per_unit - .6, (k + .5) / per_unit};
    return std::any_of(std::begin(parts), std::end(parts), [&](const Ellipsoid& e) {
      const double a = (p[0] - e.x) / e.rx, b = (p[1] - e.y) / e.ry, c = (p[2] - e.z) / e.rz;
      return a * a + b * b + c * c < 1;
    });
  };
  Workload result;
  VoxelModel& model = result.model;
  model.voxel = {2.5e-3, 2.5e-3, 2.5e-3};
  model.gravity = {0, 0, -9.81};
  std::vector<std::uint8_t> is_node(std::size_t(n + 1) * (n + 1) * (n + 1), 0);
  const auto at = [n](int i, int j, int k) { return (std::size_t(k) * (n + 1) + j) * (n + 1) + i; };
  const Moduli soft = Moduli().add(1, {48e3, .4});
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i) {
        if (!inside(i, j, k)) continue;
        // One side heavier than the other, as in the paper.
        const double x = (i + .5) / per_unit - .6;
        add_element(model, i, j, k, soft, x > .2 ? 1250 : x < -.2 ? 750 : 1000);
        for (int corner = 0; corner < 8; ++corner)
          is_node[at(i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2))] = 1;
      }
  for (int k = 0; k <= n; ++k)
    for (int j = 0; j <= n; ++j)
      for (int i = 0; i <= n; ++i) {
        if (!is_node[at(i, j, k)]) continue;
        model.node_ijk.insert(model.node_ijk.end(), {i, j, k});
        const double x = i / per_unit - .6, z = k / per_unit;
        const bool held = std::abs(x) < .12 && z > .52 && z < .74;
        model.fixed.insert(model.fixed.end(), 3, held);
      }
  return result;
}

Workload block(int nx, int ny, int nz) {
  Workload result;
  result.model = flat_block(nx, ny, nz, true);
  return result;
}

struct Named {
  const char* name;
  std::size_t elements;
  Workload (*make)(std::size_t elements);
};

int side(double cells) { return std::max(5, static_cast<int>(std::lround(cells))); }

const Named kWorkloads[] = {
    {"flat-block", 129600,
     [](std::size_t n) {
       const int s = side(std::sqrt(double(n) / 9));
       return block(s, s, 9);
     }},
    {"face", kFaceElements, &face},
    {"armadillo", kFigureElements, &figure},
    {"slab", 409600,  // rows of 16 m nodes, so that lanes are filled at every size
     [](std::size_t n) {
       const int s = 16 * std::max(1, static_cast<int>(std::lround(std::sqrt(double(n)) / 64)));
       return block(s - 1, s, 16);
     }},
    {"dense-block", std::size_t(512) * 512 * 64,
     [](std::size_t n) {
       const int s = side(2 * std::cbrt(double(n)));
       return block(s, s, std::max(4, s / 8));
     }},
    {"sparse-shell", std::size_t(1789) * 1789 * kShellThickness, &sparse_shell},
};

const Named& find(const std::string& name) {
  std::string known;
  for (const Named& workload : kWorkloads) {
    if (name == workload.name) return workload;
    known += (known.empty() ? "" : ", ") + std::string(workload.name);
  }
  throw InputError("workload: got '" + name + "', allowed are " + known);
}

}  // namespace

const std::vector<std::string>& workload_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> all;
    for (const Named& workload : kWorkloads) all.emplace_back(workload.name);
    return all;
  }();
  return names;
}

std::size_t workload_elements(const std::string& name) { return find(name).elements; }

Workload make_workload(const std::string& name, std::size_t elements) {
  const Named& workload = find(name);
  Workload result = workload.make(elements ? elements : workload.elements);
  result.name = name;
  result.activation = result.model.muscles.empty() ? 0 : kActivation;
  return result;
}

}  // namespace tledface::bench
