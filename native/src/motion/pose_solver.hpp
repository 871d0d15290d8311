// Poses of a skeleton whose bones are to lie as targets say: bounded Gauss-Newton steps, all frames of a clip at once.
#pragma once

#include <string>
#include <vector>

#include "evaluator/affine.hpp"

namespace physkin {

// One rotation about a fixed axis, as `Rig` has them; `parent` is the turn before it on the way from the root, -1:
// none.
struct Turn {
  int parent;
  Vector3Of<double> axis;
  double rest, lower, upper;
};

// A bone that is to follow: the last turn that moves it, and its weighted axes at rest, in columns.
struct Follower {
  int turn;
  Matrix3Of<double> axes;
};

// How hard a joint position is pulled to its rest, and to the mean of the frames before and after [1/rad]; how far one
// step may go [rad].
struct Pulls {
  double rest, neighbours, longest_step;
};

// Not for use by two threads at once.
class PoseSolver {
 public:
  // Throws std::invalid_argument where a parent does not come before its turn, or a follower's turn does not exist.
  PoseSolver(std::vector<Turn> turns, std::vector<Follower> followers, Pulls pulls);

  int turns() const { return int(turns_.size()); }
  int followers() const { return int(followers_.size()); }

  // One step of every frame from positions (frames, turns) to `next`, of the same shape and elsewhere. targets
  // (frames, followers, 3, 3): where the followers' axes should be.
  void step(const double* targets, const double* positions, int frames, double* next);

 private:
  double& entry(int turn, int ancestor) { return normal_[std::size_t(turn) * turns_.size() + std::size_t(ancestor)]; }
  void pose(const double* positions);
  void gather(const double* targets);
  void solve();

  std::vector<Turn> turns_;
  std::vector<Follower> followers_;
  Pulls pulls_;
  // By turn: what it turns to; its axis then; the curvature of all it moves, and their torque.
  std::vector<Matrix3Of<double>> rotations_, curvatures_;
  std::vector<Vector3Of<double>> axes_, torques_;
  std::vector<char> held_;
  std::vector<double> normal_, step_;
};

}  // namespace physkin
