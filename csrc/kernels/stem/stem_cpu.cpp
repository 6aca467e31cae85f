#include <algorithm>
#include <cstring>

#include "../common/parallel.h"
#include "../common/rgb.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "stem.h"

namespace anynet::ANYNET_ISA {
namespace {

/// One thread's rows. A row holds its columns 0, 4, 8, ..., then 1, 5, 9, ... and so on: four `phases`, each with a
/// vector of zeros before and after it.
template <class T>
class Strip {
 public:
  Strip(const Stem<T>& a, int image)
      : a_(a),
        image_(a.image[image]),
        quarter_(a.width / 4),
        pitch_((quarter_ + 4 * lanes<T> - 1) / lanes<T> * lanes<T>),
        inputs_(12, row()),
        first_(5 * a.channels, row()),
        planes_(a.input_scale == 2 ? 3 * 6 * pitch_ : 0),
        result_(4 * pitch_) {
    fill_zero<T>(inputs_, 4 * 3 * row());
    fill_zero<T>(first_, 5 * a.channels * row());
  }

  /// Output rows [begin, end), to out [C,height/4,width/4].
  void compute(int64_t begin, int64_t end, T* out) {
    for (int64_t r = 4 * begin - 2; r <= 4 * begin; ++r) read(r);
    convolve_first(4 * begin - 1);
    for (int64_t y = begin; y < end; ++y) {
      for (int64_t r = 4 * y; r < 4 * y + 4; ++r) {
        read(r + 1);
        convolve_first(r);
      }
      const int64_t plane = a_.height / 4 * quarter_;
      int64_t o = 0;
      for (; o + 4 <= a_.channels; o += 4) convolve_second<4>(y, o, out + y * quarter_, plane);
      for (; o < a_.channels; ++o) convolve_second<1>(y, o, out + y * quarter_, plane);
    }
  }

 private:
  int64_t row() const { return 4 * pitch_; }
  /// Where column 4 j + phase is element j, for rows that four (inputs) or five (first) slots go round.
  T* input(int64_t r, int64_t channel, int phase) {
    return inputs_ + (((r + 4) % 4) * 3 + channel) * row() + phase * pitch_ + lanes<T>;
  }
  T* first(int64_t r, int64_t channel, int phase) {
    return first_ + (((r + 5) % 5) * a_.channels + channel) * row() + phase * pitch_ + lanes<T>;
  }

  /// Row r of x.
  void read(int64_t r) {
    if (r < 0 || r >= a_.height) {
      for (int c = 0; c < 3; ++c) fill_zero(input(r, c, 0) - lanes<T>, row());
      return;
    }
    if (a_.input_scale == 2) {
      read_upsampled(r);
    } else {
      read_plain(r);
    }
    for (int c = 0; c < 3; ++c) input(r, c, 0)[quarter_] = 0;  // the padding's column
  }

  void read_plain(int64_t r) {
    const uint8_t* row = image_ + std::min(r, a_.image_height - 1) * a_.image_width * 3;
    for (int64_t j = 0; j < quarter_; j += lanes<T>) {
      const FourPixels pixels(row, a_.image_width, j);
#pragma GCC unroll 12
      for (int i = 0; i < 12; ++i) {
        store(input(r, i % 3, i / 3) + j, __builtin_convertvector(pixels[i], vec<T>) - a_.mean[i % 3]);
      }
    }
  }

  /// Between two rows of the image: 3/4 of the nearer, 1/4 of the farther.
  void read_upsampled(int64_t r) {
    const T *near = deinterleave(r / 2), *far = deinterleave(r % 2 ? r / 2 + 1 : std::max(r / 2 - 1, int64_t{0}));
    for (int c = 0; c < 3; ++c, near += 2 * pitch_, far += 2 * pitch_) {
      const vec<T> mean = splat(a_.mean[c]), much = splat(T(0.75)), little = splat(T(0.25));
      const auto between = [&](int64_t i) { return much * load(near + i) + little * load(far + i) - mean; };
      T* out = input(r, c, 0);
      for (int64_t j = 0; j < quarter_; j += lanes<T>) {
        const vec<T> before = between(pitch_ + j - 1), even = between(j), odd = between(pitch_ + j),
                     after = between(j + 1);
        store(out + j, much * even + little * before);
        store(out + pitch_ + j, much * even + little * odd);
        store(out + 2 * pitch_ + j, much * odd + little * even);
        store(out + 3 * pitch_ + j, much * odd + little * after);
      }
    }
  }

  /// A row of the image, or its last: per channel the even and the odd columns, one more at either end, a pitch apart.
  const T* deinterleave(int64_t r) {
    r = std::min(r, a_.image_height - 1);
    T* planes = planes_ + r % 3 * 6 * pitch_ + lanes<T>;
    if (held_[r % 3] == r) return planes;
    held_[r % 3] = r;
    const uint8_t* pixels = image_ + r * a_.image_width * 3;
    const int64_t pairs = a_.image_width / 2;
    for (int c = 0; c < 3; ++c) {
      T* __restrict even = planes + 2 * c * pitch_;
      T* __restrict odd = even + pitch_;
      for (int64_t j = 0; j < pairs; ++j) {
        even[j] = pixels[6 * j + c];
        odd[j] = pixels[6 * j + 3 + c];
      }
      const T last = pixels[3 * a_.image_width - 3 + c];
      if (a_.image_width % 2) even[pairs] = last;
      for (int64_t j = pairs + a_.image_width % 2; j <= quarter_; ++j) even[j] = last;
      for (int64_t j = pairs; j < quarter_; ++j) odd[j] = last;
      odd[-1] = pixels[c];
    }
    return planes;
  }

  /// Row r of f, from rows r - 1 to r + 1 of x.
  void convolve_first(int64_t r) {
    int64_t o = 0;
    if (r < 0) {
      for (; o < a_.channels; ++o) fill_zero(first(r, o, 0) - lanes<T>, row());
      return;
    }
    for (; o + 2 <= a_.channels; o += 2) convolve_first<2, 1>(r, o);
    if (o < a_.channels) convolve_first<1, 2>(r, o);
  }

  /// Of channels [o, o + N), V vectors at a time: N * V * 4 sums hide how long a multiply-add takes. (Inlined, it would
  /// not keep them in registers.)
  template <int N, int V>
  __attribute__((noinline)) void convolve_first(int64_t r, int64_t o) {
    constexpr int L = lanes<T>;
    const T* in[9];
    for (int i = 0; i < 9; ++i) in[i] = input(r + i % 3 - 1, i / 3, 0);
    const T* weight = a_.weight_first + o * 27;
    for (int64_t j = 0; j < quarter_; j += V * L) {
      vec<T> sum[N][V][4];
      for (int n = 0; n < N; ++n) {
        for (auto& phases : sum[n]) {
          for (auto& s : phases) s = splat(a_.bias_first[o + n]);
        }
      }
      for (int i = 0; i < 9; ++i) {
        for (int v = 0; v < V; ++v) {
          const T* p = in[i] + j + v * L;
          const vec<T> x[6] = {load(p + 3 * pitch_ - 1), load(p),    load(p + pitch_), load(p + 2 * pitch_),
                               load(p + 3 * pitch_),     load(p + 1)};
          for (int k = 0; k < 3; ++k) {
            for (int n = 0; n < N; ++n) {
              const vec<T> w = splat(weight[27 * n + 3 * i + k]);
              for (int phase = 0; phase < 4; ++phase) add_product<T>(sum[n][v][phase], w, x[phase + k]);
            }
          }
        }
      }
      for (int n = 0; n < N; ++n) {
        for (int v = 0; v < V; ++v) {
          T* out = first(r, o + n, 0) + j + v * L;
          for (int phase = 0; phase < 4; ++phase) store(out + phase * pitch_, max<T>(vec<T>{}, sum[n][v][phase]));
        }
      }
    }
  }

  /// The larger of each pair; NaN if one of them is.
  static vec<T> larger(vec<T> p, vec<T> q) {
    const vec<T> most = max<T>(p, q);  // NaN if q is
    return p != p ? p : most;
  }

  /// Row y of the output, of channels [o, o + N), to rows `plane` apart. (Not inlined either.)
  template <int N>
  __attribute__((noinline)) void convolve_second(int64_t y, int64_t o, T* out, int64_t plane) {
    for (int64_t j = 0; j < quarter_; j += lanes<T>) {
      vec<T> pooled[N][2];
      for (int half = 0; half < 2; ++half) {
        vec<T> left[N] = {}, right[N] = {};  // columns 2 j and 2 j + 1 of h
        for (int64_t c = 0; c < a_.channels; ++c) {
          for (int ky = 0; ky < 3; ++ky) {
            const T* f = first(4 * y + 2 * half + ky - 1, c, 0) + j;
            const vec<T> x[5] = {load(f + 3 * pitch_ - 1), load(f), load(f + pitch_), load(f + 2 * pitch_),
                                 load(f + 3 * pitch_)};
            for (int n = 0; n < N; ++n) {
              const T* weight = a_.weight_second + ((o + n) * a_.channels + c) * 9 + 3 * ky;
              for (int k = 0; k < 3; ++k) {
                const vec<T> w = splat(weight[k]);
                add_product<T>(left[n], w, x[k]);
                add_product<T>(right[n], w, x[k + 2]);
              }
            }
          }
        }
        for (int n = 0; n < N; ++n) pooled[n][half] = larger(left[n], right[n]);
      }
      for (int n = 0; n < N; ++n) {
        const vec<T> value = splat(a_.epilogue.scale[o + n]) * larger(pooled[n][0], pooled[n][1]);
        store(result_ + n * pitch_ + j, max<T>(vec<T>{}, value + splat(a_.epilogue.shift[o + n])));
      }
    }
    for (int n = 0; n < N; ++n) {
      std::memcpy(out + (o + n) * plane, static_cast<T*>(result_) + n * pitch_, quarter_ * sizeof(T));
    }
  }

  const Stem<T>& a_;
  const uint8_t* image_;
  const int64_t quarter_, pitch_;
  uint8_t bytes_[12 * lanes<T>];
  Scratch<T> inputs_, first_;
  Scratch<T> planes_;  // of the last three rows of the image that were deinterleaved
  int64_t held_[3] = {-1, -1, -1};
  Scratch<T> result_;  // rows of the output, each with room for whole vectors
};

}  // namespace

template <class T>
void stem(const Stem<T>& a, int threads) {
  const int64_t rows = a.height / 4, image_size = a.channels * rows * (a.width / 4);
  parallel_ranges(2 * rows, threads, [&](int64_t begin, int64_t end) {
    for (int image = 0; image < 2; ++image) {
      const int64_t from = std::max(begin - image * rows, int64_t{0}), to = std::min(end - image * rows, rows);
      if (from < to) Strip<T>(a, image).compute(from, to, a.out + image * image_size);
    }
  });
}

template void stem<float>(const Stem<float>&, int);

}  // namespace anynet::ANYNET_ISA
