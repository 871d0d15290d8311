// Choice, by measurement, of how a network's layers read their network weights.
#pragma once

#include <chrono>
#include <cstddef>
#include <vector>

#include "mlp.hpp"

namespace physkin {

// Times runs of one network in each of several ways. Caches and clocks drift: the ways take turns, the fastest round of
// each counts.
class RowReadingTrial {
 public:
  // candidates: at least one.
  RowReadingTrial(Mlp& network, const std::vector<RowReading>& candidates)
      : network_(network), candidates_(candidates), best_(candidates.size(), 1e30) {}

  void begin_round(std::size_t candidate) {
    network_.set_reading(candidates_[now_ = candidate]);
    seconds_ = 0.0;
  }

  const float* timed_run(const float* input, const float* modulation) {
    const auto start = std::chrono::steady_clock::now();
    const float* output = network_.run(input, modulation);
    seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return output;
  }

  void end_round() { best_[now_] = seconds_ < best_[now_] ? seconds_ : best_[now_]; }

  // Sets the fastest way.
  void decide() {
    std::size_t fastest = 0;
    for (std::size_t k = 1; k < best_.size(); ++k) fastest = best_[k] < best_[fastest] ? k : fastest;
    network_.set_reading(candidates_[fastest]);
  }

 private:
  Mlp& network_;
  const std::vector<RowReading>& candidates_;
  std::vector<double> best_;
  std::size_t now_ = 0;
  double seconds_ = 0.0;
};

}  // namespace physkin
