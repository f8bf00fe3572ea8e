// Bundle adjustment by the Ceres solver on one thread; see checks/ceres.py, which writes its problem and reads its solution.
//
//     solve PROBLEM SOLUTION SOLVER DERIVATIVES ITERATIONS RUNS
//
// PROBLEM: number of views, points and observations, robust scale, relative decrease; lenses (fx, fy, cx, cy), start of the poses
// (rotation vector, translation; camera from world) and points; of every observation view, point, pixel and sigma. All of them
// float64. SOLUTION: poses and points. DERIVATIVES: `analytic`, or `automatic` by Ceres's dual numbers.

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <fstream>
#include <iostream>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Matrix23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using Matrix26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;

struct Observation {
  const double* lens;
  double pixel[2];
  double per_sigma;

  // The residual of a pose and a point, for numbers and for dual numbers.
  template <typename T>
  bool operator()(const T* pose, const T* point, T* residual) const {
    T p[3];
    ceres::AngleAxisRotatePoint(pose, point, p);
    for (int k = 0; k < 3; ++k) p[k] += pose[3 + k];
    residual[0] = (lens[0] * p[0] / p[2] + lens[2] - pixel[0]) * per_sigma;
    residual[1] = (lens[1] * p[1] / p[2] + lens[3] - pixel[1]) * per_sigma;
    return true;
  }
};

Matrix3 skew(const Eigen::Vector3d& a) {
  return (Matrix3() << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0).finished();
}

class AnalyticCost : public ceres::SizedCostFunction<2, 6, 3> {
 public:
  explicit AnalyticCost(const Observation& observation) : observation_(observation) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (jacobians == nullptr) return observation_(parameters[0], parameters[1], residuals);
    const Eigen::Map<const Eigen::Vector3d> turn(parameters[0]), shift(parameters[0] + 3), point(parameters[1]);
    // R = I + b [w]x + c [w]x^2; the left Jacobian of the rotation is I + c [w]x + d [w]x^2.
    const double squared = turn.squaredNorm(), angle = std::sqrt(squared);
    const bool is_small = squared < 1e-12;
    const double sine = std::sin(angle);
    const double b = is_small ? 1 : sine / angle, c = is_small ? 0.5 : (1 - std::cos(angle)) / squared;
    const double d = is_small ? 1.0 / 6 : (angle - sine) / (squared * angle);
    const Matrix3 w = skew(turn), w2 = turn * turn.transpose() - squared * Matrix3::Identity();
    const Matrix3 rotation = Matrix3::Identity() + b * w + c * w2;
    const Eigen::Vector3d turned = rotation * point, p = turned + shift;
    const double* lens = observation_.lens;
    const double fx = lens[0] * observation_.per_sigma / p.z(), fy = lens[1] * observation_.per_sigma / p.z();
    residuals[0] = fx * p.x() + (lens[2] - observation_.pixel[0]) * observation_.per_sigma;
    residuals[1] = fy * p.y() + (lens[3] - observation_.pixel[1]) * observation_.per_sigma;
    Matrix23 by_p;
    by_p << fx, 0, -fx * p.x() / p.z(), 0, fy, -fy * p.y() / p.z();
    if (jacobians[0] != nullptr) {
      const Matrix3 left = Matrix3::Identity() + c * w + d * w2;
      Eigen::Map<Matrix26> by_pose(jacobians[0]);
      by_pose.leftCols<3>().noalias() = -(by_p * skew(turned)) * left;
      by_pose.rightCols<3>() = by_p;
    }
    if (jacobians[1] != nullptr) Eigen::Map<Matrix23>(jacobians[1]).noalias() = by_p * rotation;
    return true;
  }

 private:
  const Observation observation_;
};

// rho(s) = k^2 s / (k^2 + s), which Ceres does not have.
class GemanMcClure : public ceres::LossFunction {
 public:
  explicit GemanMcClure(double scale) : squared_(scale * scale) {}
  void Evaluate(double s, double rho[3]) const override {
    const double ratio = squared_ / (squared_ + s);
    rho[0] = s * ratio;
    rho[1] = ratio * ratio;
    rho[2] = -2 * rho[1] * ratio / squared_;
  }

 private:
  const double squared_;
};

class Scene {
 public:
  explicit Scene(const char* path) : file_(path, std::ios::binary) {
    const std::vector<double> head = numbers(5);
    views_ = size_t(head[0]), points_ = size_t(head[1]);
    robust_scale = head[3], relative_decrease = head[4];
    lenses_ = numbers(4 * views_);
    start_ = numbers(6 * views_ + 3 * points_);
    observations_ = numbers(5 * size_t(head[2]));
  }

  // The unknowns are `values`, which begin at the start.
  void build(bool is_automatic, ceres::Problem* problem, ceres::ParameterBlockOrdering* ordering) {
    values = start_;
    double* points = values.data() + 6 * views_;
    for (size_t i = 0; i < observations_.size(); i += 5) {
      const double* o = &observations_[i];
      const Observation observation{&lenses_[4 * size_t(o[0])], {o[2], o[3]}, 1 / o[4]};
      ceres::CostFunction* cost;
      if (is_automatic) {
        cost = new ceres::AutoDiffCostFunction<Observation, 2, 6, 3>(new Observation(observation));
      } else {
        cost = new AnalyticCost(observation);
      }
      double *pose = &values[6 * size_t(o[0])], *point = points + 3 * size_t(o[1]);
      problem->AddResidualBlock(cost, loss(), pose, point);
      ordering->AddElementToGroup(point, 0);
      ordering->AddElementToGroup(pose, 1);
    }
    // Where the gauge is held is the solver's own matter; Ceres's users hold the first camera, the damping holds the scale.
    problem->SetParameterBlockConstant(values.data());
  }

  std::vector<double> values;
  double robust_scale, relative_decrease;

 private:
  ceres::LossFunction* loss() {
    if (!loss_) loss_ = std::make_unique<GemanMcClure>(robust_scale);
    return loss_.get();
  }

  std::vector<double> numbers(size_t count) {
    std::vector<double> read(count);
    file_.read(reinterpret_cast<char*>(read.data()), std::streamsize(count * sizeof(double)));
    if (!file_) throw std::runtime_error("the problem ends early");
    return read;
  }

  std::ifstream file_;
  size_t views_, points_;
  std::vector<double> lenses_, start_, observations_;
  std::unique_ptr<ceres::LossFunction> loss_;
};

ceres::Solver::Options options_of(const std::string& solver, double relative_decrease, int iterations) {
  ceres::Solver::Options options;
  if (!ceres::StringToLinearSolverType(solver, &options.linear_solver_type)) throw std::runtime_error("unknown solver");
  // Of the iterative solver, the variant for few cameras.
  options.preconditioner_type = ceres::SCHUR_JACOBI;
  options.use_explicit_schur_complement = options.linear_solver_type == ceres::ITERATIVE_SCHUR;
  options.num_threads = 1;
  options.max_num_iterations = iterations;
  options.function_tolerance = relative_decrease;
  // The other criteria are ours neither.
  options.gradient_tolerance = options.parameter_tolerance = 0;
  options.logging_type = ceres::SILENT;
  return options;
}

int main(int count, char** arguments) {
  if (count != 7) return 2;
  google::InitGoogleLogging(arguments[0]);
  Scene scene(arguments[1]);
  double seconds = std::numeric_limits<double>::infinity();
  ceres::Solver::Summary summary;
  for (int run = 0; run < std::stoi(arguments[6]); ++run) {
    ceres::Problem::Options shared;
    shared.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(shared);
    auto options = options_of(arguments[3], scene.relative_decrease, std::stoi(arguments[5]));
    options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    scene.build(std::string(arguments[4]) == "automatic", &problem, options.linear_solver_ordering.get());
    ceres::Solve(options, &problem, &summary);
    seconds = std::min(seconds, summary.minimizer_time_in_seconds);
  }
  if (!summary.IsSolutionUsable()) throw std::runtime_error(summary.message);
  std::ofstream(arguments[2], std::ios::binary)
      .write(reinterpret_cast<const char*>(scene.values.data()), std::streamsize(scene.values.size() * sizeof(double)));
  // Every step solves one linear system, also one that is then rejected.
  std::cout << "{\"iterations\": " << summary.num_linear_solves << ", \"seconds\": " << seconds
            << ", \"jacobian_s\": " << summary.jacobian_evaluation_time_in_seconds
            << ", \"residual_s\": " << summary.residual_evaluation_time_in_seconds
            << ", \"linear_s\": " << summary.linear_solver_time_in_seconds << ", \"version\": \"" CERES_VERSION_STRING "\""
            << ", \"cost\": " << summary.final_cost << ", \"structure\": \"" << summary.schur_structure_used << "\"}\n";
}
