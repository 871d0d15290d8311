#include "garment/spread_points.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace physkin {
namespace {

// Points that follow each other; those of a cell are looked at only where a chosen point is near enough to it.
constexpr int kCell = 64;

double distance_squared(const double* a, const double* b, int width) {
  double sum = 0;
  for (int k = 0; k < width; ++k) sum += (a[k] - b[k]) * (a[k] - b[k]);
  return sum;
}

struct Cell {
  int first, end, farthest;  // of its points the one that is the farthest from those chosen, and how far, squared
  double distance, radius;   // about its middle
  double reach;              // squared, from its middle, of what is near enough
};

double reach_of(const Cell& cell) {
  const double reach = cell.radius + std::sqrt(cell.distance) + 1e-9;  // the more for roundings
  return reach * reach;
}

// middles: (cells, width).
std::vector<Cell> cells_of(const double* points, int count, int width, std::vector<double>& middles) {
  std::vector<Cell> cells;
  for (int first = 0; first < count; first += kCell) {
    const int end = std::min(first + kCell, count);
    constexpr double kAny = std::numeric_limits<double>::infinity();
    Cell cell{first, end, first, kAny, 0, kAny};
    std::vector<double> middle(std::size_t(width), 0.0);
    for (int i = first; i < end; ++i) {
      for (int k = 0; k < width; ++k) middle[std::size_t(k)] += points[std::ptrdiff_t(i) * width + k] / (end - first);
    }
    for (int i = first; i < end; ++i) {
      const double square = distance_squared(points + std::ptrdiff_t(i) * width, middle.data(), width);
      cell.radius = std::max(cell.radius, std::sqrt(square));
    }
    cells.push_back(cell);
    middles.insert(middles.end(), middle.begin(), middle.end());
  }
  return cells;
}

}  // namespace

void spread_points(const double* points, int count, int width, std::int32_t* chosen, int chosen_count) {
  std::vector<double> middles;
  std::vector<Cell> cells = cells_of(points, count, width, middles);
  std::vector<double> distances(std::size_t(count), std::numeric_limits<double>::infinity());
  if (chosen_count > 0) chosen[0] = 0;
  for (int n = 1; n < chosen_count; ++n) {
    const double* last = points + std::ptrdiff_t(chosen[n - 1]) * width;
    const Cell* farthest = &cells.front();
    for (Cell& cell : cells) {
      if (distance_squared(last, middles.data() + (&cell - cells.data()) * width, width) < cell.reach) {
        cell.distance = -1;
        for (int i = cell.first; i < cell.end; ++i) {
          double& distance = distances[std::size_t(i)];
          distance = std::min(distance, distance_squared(last, points + std::ptrdiff_t(i) * width, width));
          if (!(distance > cell.distance)) continue;
          cell.distance = distance;
          cell.farthest = i;
        }
        cell.reach = reach_of(cell);
      }
      if (cell.distance > farthest->distance) farthest = &cell;
    }
    chosen[n] = farthest->farthest;
  }
}

}  // namespace physkin
