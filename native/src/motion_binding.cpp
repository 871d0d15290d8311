// The part of physkin_core._native that brings motion capture onto a rig: checks and converts, computes nothing.
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "bindings.hpp"
#include "motion/pose_solver.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Numbers = std::vector<double>;
using Positions = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Targets = nb::ndarray<const double, nb::shape<-1, -1, 3, 3>, nb::c_contig, nb::device::cpu>;
using NextPositions = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

PoseSolver pose_solver(const std::vector<int>& parents, const std::vector<Numbers>& turns,
                       const std::vector<int>& follower_turns, const std::vector<Numbers>& follower_axes,
                       const Numbers& pulls) {
  const auto sized = [](const std::vector<Numbers>& rows, std::size_t count, std::size_t width) {
    return rows.size() == count &&
           std::all_of(rows.begin(), rows.end(), [&](auto& row) { return row.size() == width; });
  };
  if (!sized(turns, parents.size(), 6) || !sized(follower_axes, follower_turns.size(), 9) || pulls.size() != 3) {
    throw std::invalid_argument("a turn needs a parent and 6 numbers, a follower a turn and 9, and there are 3 pulls");
  }
  std::vector<Turn> tree;
  for (std::size_t k = 0; k < turns.size(); ++k) {
    const Numbers& t = turns[k];
    tree.push_back({parents[k], load_vector(t.data()), t[3], t[4], t[5]});
  }
  std::vector<Follower> followers;
  for (std::size_t k = 0; k < follower_turns.size(); ++k) {
    const double* axes = follower_axes[k].data();
    followers.push_back({follower_turns[k], {load_vector(axes), load_vector(axes + 3), load_vector(axes + 6)}});
  }
  return PoseSolver(std::move(tree), std::move(followers), {pulls[0], pulls[1], pulls[2]});
}

void step(PoseSolver& self, const Targets& targets, const Positions& positions, const NextPositions& next) {
  const std::size_t frames = positions.shape(0), turns = std::size_t(self.turns());
  if (positions.shape(1) != turns || next.shape(0) != frames || next.shape(1) != turns || targets.shape(0) != frames ||
      targets.shape(1) != std::size_t(self.followers())) {
    throw std::invalid_argument("positions and next must be (frames, " + std::to_string(turns) +
                                "), targets (frames, " + std::to_string(self.followers()) + ", 3, 3)");
  }
  const nb::gil_scoped_release release;
  self.step(targets.data(), positions.data(), int(frames), next.data());
}

}  // namespace

void bind_motion(nb::module_& module) {
  nb::class_<PoseSolver>(module, "PoseSolver")
      .def(nb::new_(&pose_solver), "parents"_a, "turns"_a, "follower_turns"_a, "follower_axes"_a, "pulls"_a)
      .def("step", &step, "targets"_a.noconvert(), "positions"_a.noconvert(), "next"_a.noconvert());
}

}  // namespace physkin
