// The disparity of a pair of images within a budget, without Python:
//
//   anytime PACKAGE LIBRARY LEFT RIGHT OUT.tiff [BUDGET_MS]
//
// PACKAGE is of `anynet export --format aoti`, for images of this size, and LIBRARY the _C.so that `anynet info` names,
// which holds our operators. Prints each stage's time; writes the last stage's disparity in pixels, float32.

#include <ATen/Tensor.h>
#include <ATen/ops/empty.h>
#include <c10/core/InferenceMode.h>
#include <dlfcn.h>
#include <torch/csrc/inductor/aoti_package/model_package_loader.h>

#include <chrono>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using Package = torch::inductor::AOTIModelPackageLoader;

std::vector<std::string> words(const std::string& text) {
  std::istringstream stream(text);
  return {std::istream_iterator<std::string>(stream), {}};
}

// A compiled model whose inputs and outputs have names.
class Model {
 public:
  Model(const std::string& package, const std::string& name) : loader_(package, name) {
    auto metadata = loader_.get_metadata();
    inputs_ = words(metadata.at("inputs"));
    outputs_ = words(metadata.at("outputs"));
  }

  // Takes its inputs from `values`, and adds its outputs. Returns the first one.
  at::Tensor run(std::map<std::string, at::Tensor>& values) {
    std::vector<at::Tensor> arguments;
    for (const std::string& name : inputs_) arguments.push_back(values.at(name));
    const std::vector<at::Tensor> results = loader_.run(arguments);
    for (size_t i = 0; i < results.size(); ++i) values[outputs_[i]] = results[i];
    return results[0];
  }

 private:
  Package loader_;
  std::vector<std::string> inputs_, outputs_;
};

// A network that can be stopped after each of its stages.
class Anytime {
 public:
  explicit Anytime(const std::string& package) {
    auto metadata = Package::load_metadata_from_package(package, "model");
    height_ = std::stol(metadata.at("height"));
    width_ = std::stol(metadata.at("width"));
    for (size_t stage = 1; stage <= words(metadata.at("outputs")).size(); ++stage)
      stages_.push_back(std::make_unique<Model>(package, "stage_" + std::to_string(stage)));
    expected_ms_.resize(stages_.size());
  }

  // The disparity [H, W] of the last stage that fits into the budget, going by the last frame. The first one always
  // runs.
  at::Tensor predict(const at::Tensor& left, const at::Tensor& right, double budget_ms) {
    if (left.size(0) != height_ || left.size(1) != width_ || left.sizes() != right.sizes())
      throw std::runtime_error("expected images of " + std::to_string(width_) + " x " + std::to_string(height_));
    const c10::InferenceMode inference;
    std::map<std::string, at::Tensor> values{{"left", left}, {"right", right}};
    at::Tensor disparity;
    double elapsed = 0;
    const auto start = std::chrono::steady_clock::now();
    for (size_t k = 0; k < stages_.size(); ++k) {
      if (k > 0 && elapsed + expected_ms_[k] > budget_ms) break;
      disparity = stages_[k]->run(values);
      const std::chrono::duration<double, std::milli> now = std::chrono::steady_clock::now() - start;
      expected_ms_[k] = now.count() - elapsed;
      elapsed = now.count();
      std::printf("stage %zu: %.2f ms\n", k + 1, elapsed);
    }
    return disparity;
  }

 private:
  int64_t height_, width_;
  std::vector<std::unique_ptr<Model>> stages_;
  std::vector<double> expected_ms_;
};

// uint8 RGB [H, W, 3].
at::Tensor read(const std::string& path) {
  if (!std::filesystem::is_regular_file(path))
    throw std::runtime_error(path + ": cannot be read");  // OpenCV would warn
  const cv::Mat image = cv::imread(path, cv::IMREAD_COLOR);
  if (image.empty()) throw std::runtime_error(path + ": cannot be read");
  at::Tensor out = at::empty({image.rows, image.cols, 3}, at::kByte);
  cv::Mat rgb(image.rows, image.cols, CV_8UC3, out.data_ptr());
  cv::cvtColor(image, rgb, cv::COLOR_BGR2RGB);
  return out;
}

void write(const std::string& path, const at::Tensor& disparity) {
  const at::Tensor rows = disparity.contiguous();
  const cv::Mat map(int(rows.size(0)), int(rows.size(1)), CV_32F, rows.data_ptr());
  if (!cv::imwrite(path, map)) throw std::runtime_error(path + ": cannot be written");
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 6 || count > 7) {
    std::fprintf(stderr, "usage: %s PACKAGE LIBRARY LEFT RIGHT OUT.tiff [BUDGET_MS]\n", arguments[0]);
    return 2;
  }
  try {
    const std::string library = std::filesystem::absolute(arguments[2]);  // a bare name would be looked for elsewhere
    if (!dlopen(library.c_str(), RTLD_NOW)) throw std::runtime_error(dlerror());
    const double budget = count > 6 ? std::stod(arguments[6]) : std::numeric_limits<double>::infinity();
    const at::Tensor left = read(arguments[3]), right = read(arguments[4]);
    Anytime network(arguments[1]);
    std::puts("without a budget:");
    at::Tensor disparity = network.predict(left, right, std::numeric_limits<double>::infinity());
    if (count > 6) {
      std::printf("within %g ms:\n", budget);
      disparity = network.predict(left, right, budget);
    }
    write(arguments[5], disparity);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "anytime: %s\n", error.what());
    return 1;
  }
}
