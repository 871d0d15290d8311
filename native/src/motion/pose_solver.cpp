#include "motion/pose_solver.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace physkin {

PoseSolver::PoseSolver(std::vector<Turn> turns, std::vector<Follower> followers, Pulls pulls)
    : turns_(std::move(turns)),
      followers_(std::move(followers)),
      pulls_(pulls),
      rotations_(turns_.size()),
      curvatures_(turns_.size()),
      axes_(turns_.size()),
      torques_(turns_.size()),
      held_(turns_.size()),
      normal_(turns_.size() * turns_.size()),
      step_(turns_.size()) {
  for (int k = 0; k < this->turns(); ++k) {
    if (turns_[k].parent < -1 || turns_[k].parent >= k) {
      throw std::invalid_argument("turn " + std::to_string(k) + " has parent " + std::to_string(turns_[k].parent) +
                                  "; a parent comes before, -1 is none");
    }
  }
  for (const Follower& follower : followers_) {
    if (follower.turn < 0 || follower.turn >= this->turns()) {
      throw std::invalid_argument("a follower has turn " + std::to_string(follower.turn) + "; there are " +
                                  std::to_string(this->turns()));
    }
  }
}

void PoseSolver::step(const double* targets, const double* positions, int frames, double* next) {
  const int n = turns();
  const double to_rest = pulls_.rest * pulls_.rest, to_neighbours = pulls_.neighbours * pulls_.neighbours;
  for (int frame = 0; frame < frames; ++frame, targets += 9 * followers()) {
    const double* here = positions + std::ptrdiff_t(frame) * n;
    double* there = next + std::ptrdiff_t(frame) * n;
    const bool end = frame == 0 || frame == frames - 1;
    pose(here);
    gather(targets);
    for (int k = 0; k < n; ++k) {
      const double between = end ? here[k] : 0.5 * (here[k - n] + here[k + n]);
      const double slope =
          dot(axes_[k], torques_[k]) + to_rest * (here[k] - turns_[k].rest) + to_neighbours * (here[k] - between);
      held_[k] = slope > 0.0 ? here[k] <= turns_[k].lower : here[k] >= turns_[k].upper && slope < 0.0;
      step_[k] = held_[k] ? 0.0 : -slope;
    }
    for (int k = 0; k < n; ++k) {
      const Vector3Of<double> bent = curvatures_[k] * axes_[k];
      for (int i = k; i >= 0; i = turns_[i].parent) entry(k, i) = held_[k] || held_[i] ? 0.0 : dot(axes_[i], bent);
      entry(k, k) += held_[k] ? 1.0 : to_rest + to_neighbours;
    }
    solve();
    double longest = pulls_.longest_step;
    for (double angle : step_) longest = std::max(longest, std::abs(angle));
    const double share = pulls_.longest_step / longest;
    for (int k = 0; k < n; ++k) there[k] = std::clamp(here[k] + share * step_[k], turns_[k].lower, turns_[k].upper);
  }
}

void PoseSolver::pose(const double* positions) {
  for (int k = 0; k < turns(); ++k) {
    const Turn& turn = turns_[k];
    const Matrix3Of<double>& before = turn.parent < 0 ? kIdentity3Of<double> : rotations_[turn.parent];
    axes_[k] = before * turn.axis;
    rotations_[k] = before * rotation(turn.axis, positions[k] - turn.rest);
  }
}

// Of the sum of |axis - target|^2 / 2 over the followers below each turn: torque (its gradient about any axis w is
// w . torque) and curvature (Gauss-Newton's second derivative about axes v, w is v . curvature w).
void PoseSolver::gather(const double* targets) {
  std::fill(curvatures_.begin(), curvatures_.end(), Matrix3Of<double>{});
  std::fill(torques_.begin(), torques_.end(), Vector3Of<double>{});
  for (const Follower& follower : followers_) {
    const Matrix3Of<double> posed = rotations_[follower.turn] * follower.axes;
    const Vector3Of<double>* p = posed.rows;
    Vector3Of<double>* curvature = curvatures_[follower.turn].rows;
    const Vector3Of<double> t[3] = {load_vector(targets), load_vector(targets + 3), load_vector(targets + 6)};
    // Rows of these matrices are coordinates, their columns the axes: a dot product of rows sums over all axes.
    const double all = dot(p[0], p[0]) + dot(p[1], p[1]) + dot(p[2], p[2]);
    for (int i = 0; i < 3; ++i) {
      curvature[i] = curvature[i] - Vector3Of<double>{dot(p[i], p[0]), dot(p[i], p[1]), dot(p[i], p[2])};
    }
    curvature[0].x += all;
    curvature[1].y += all;
    curvature[2].z += all;
    Vector3Of<double>& torque = torques_[follower.turn];
    torque = torque + Vector3Of<double>{dot(t[1], p[2]) - dot(t[2], p[1]), dot(t[2], p[0]) - dot(t[0], p[2]),
                                        dot(t[0], p[1]) - dot(t[1], p[0])};
    targets += 9;
  }
  for (int k = turns() - 1; k >= 0; --k) {
    if (const int parent = turns_[k].parent; parent >= 0) {
      for (int i = 0; i < 3; ++i) {
        curvatures_[parent].rows[i] = curvatures_[parent].rows[i] + curvatures_[k].rows[i];
      }
      torques_[parent] = torques_[parent] + torques_[k];
    }
  }
}

// step <- normal^-1 step. Only a turn and its ancestors share entries: factorised from the leaves nothing fills in
// (Featherstone, Rigid Body Dynamics Algorithms, 6.5).
void PoseSolver::solve() {
  const auto above = [this](int k) { return turns_[k].parent; };
  for (int k = turns() - 1; k >= 0; --k) {
    entry(k, k) = std::sqrt(entry(k, k));
    for (int i = above(k); i >= 0; i = above(i)) entry(k, i) /= entry(k, k);
    for (int i = above(k); i >= 0; i = above(i)) {
      for (int j = i; j >= 0; j = above(j)) entry(i, j) -= entry(k, i) * entry(k, j);
    }
    step_[k] /= entry(k, k);
    for (int i = above(k); i >= 0; i = above(i)) step_[i] -= entry(k, i) * step_[k];
  }
  for (int k = 0; k < turns(); ++k) {
    for (int i = above(k); i >= 0; i = above(i)) step_[k] -= entry(k, i) * step_[i];
    step_[k] /= entry(k, k);
  }
}

}  // namespace physkin
