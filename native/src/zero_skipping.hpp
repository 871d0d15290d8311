// Choice, by measurement, of whether a network skips network weights of zero activations.
#pragma once

#include <chrono>

#include "mlp.hpp"

namespace physkin {

// Times runs of one network with and without skipping. Caches and clocks drift: the two take turns, the fastest round
// of each counts.
class ZeroSkippingTrial {
 public:
  explicit ZeroSkippingTrial(Mlp& network) : network_(network) {}

  void begin_round(bool skip) {
    network_.set_zero_skipping(skip);
    seconds_ = 0.0;
  }

  const float* timed_run(const float* input, const float* modulation) {
    const auto start = std::chrono::steady_clock::now();
    const float* output = network_.run(input, modulation);
    seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return output;
  }

  void end_round() {
    double& best = best_[network_.skips_zeros()];
    best = seconds_ < best ? seconds_ : best;
  }

  // Sets the faster way.
  void decide() { network_.set_zero_skipping(best_[true] < best_[false]); }

 private:
  Mlp& network_;
  double seconds_ = 0.0;
  double best_[2] = {1e30, 1e30};
};

}  // namespace physkin
