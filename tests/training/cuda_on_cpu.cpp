// The kernels of training/backends/att_snn.cu on the CPU: each CUDA thread is a thread, blocks run one after
// another, and instructions of a warp exchange their operands over barriers.
#include <barrier>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#define EMULATED
#define __device__
#define __forceinline__ inline
#define __global__
#define __restrict__
#define __launch_bounds__(...)
#define __shared__ static
#define __align__(size) __attribute__((aligned(size)))

struct Index {
  int x;
};
struct alignas(16) uint4 {
  uint32_t x, y, z, w;
};
struct alignas(16) int4 {
  int x, y, z, w;
};
struct alignas(16) float4 {
  float x, y, z, w;
};
inline uint4 make_uint4(uint32_t x, uint32_t y, uint32_t z, uint32_t w) { return {x, y, z, w}; }

static thread_local Index threadIdx, blockIdx, blockDim;
static uint4 stored[1 << 16];
static std::barrier<>* of_block;
static std::vector<std::unique_ptr<std::barrier<>>> of_warp;
static std::mutex adding;

struct Exchange {
  uint32_t a[32][4], b[32][2];
  float value[32];
};
static Exchange exchanges[64];

inline int warp() { return threadIdx.x / 32; }
inline int lane() { return threadIdx.x % 32; }
inline void meet() { of_warp[warp()]->arrive_and_wait(); }
inline void __syncthreads() { of_block->arrive_and_wait(); }
inline uint32_t __umulhi(uint32_t a, uint32_t b) { return ((uint64_t)a * b) >> 32; }
inline uint32_t __float_as_uint(float x) {
  uint32_t bits;
  memcpy(&bits, &x, 4);
  return bits;
}
inline float __uint_as_float(uint32_t bits) {
  float x;
  memcpy(&x, &bits, 4);
  return x;
}
template <class T>
void atomicAdd(T* to, T x) {
  std::lock_guard<std::mutex> lock(adding);
  *to += x;
}
inline float __shfl_xor_sync(uint32_t, float x, int mask) {
  exchanges[warp()].value[lane()] = x;
  meet();
  const float other = exchanges[warp()].value[lane() ^ mask];
  meet();
  return other;
}

// Where an instruction of the tensor cores has its operands (PTX ISA, mma.m16n8k32 and mma.m16n8k16).
inline const Exchange& share(const uint32_t* a, uint32_t b0, uint32_t b1) {
  Exchange& of = exchanges[warp()];
  memcpy(of.a[lane()], a, 16);
  of.b[lane()][0] = b0, of.b[lane()][1] = b1;
  meet();
  return of;
}
template <int K, int PER_REGISTER, class Sum, class Value>
void multiply(Sum* c, const uint32_t* a, uint32_t b0, uint32_t b1, Value value) {
  const Exchange& of = share(a, b0, b1);
  const int half = K / 2, bits = 32 / PER_REGISTER;
  for (int q = 0; q < 4; q++) {
    const int row = lane() / 4 + 8 * (q / 2), column = 2 * (lane() % 4) + q % 2;
    Sum sum = 0;
    for (int k = 0; k < K; k++) {
      const int at = k % half / PER_REGISTER, shift = bits * (k % PER_REGISTER);
      const uint32_t left = of.a[row % 8 * 4 + at][(row >= 8) + 2 * (k >= half)] >> shift;
      const uint32_t right = of.b[column * 4 + at][k >= half] >> shift;
      sum += value(left) * value(right);
    }
    c[q] += sum;
  }
  meet();
}
inline void mma_int8(int* c, const uint32_t* a, uint32_t b0, uint32_t b1) {
  multiply<32, 4>(c, a, b0, b1, [](uint32_t x) { return (int)(int8_t)x; });
}
inline void mma_bf16(float* c, const uint32_t* a, uint32_t b0, uint32_t b1) {
  multiply<16, 2>(c, a, b0, b1, [](uint32_t x) { return __uint_as_float(x << 16); });
}

#include "att_snn.cu"

template <class Kernel>
void launch(int blocks, Kernel kernel) {
  const int threads = WARPS * 32;
  for (int b = 0; b < blocks; b++) {
    std::barrier<> all(threads);
    of_block = &all;
    of_warp.clear();
    for (int w = 0; w < WARPS; w++) of_warp.emplace_back(new std::barrier<>(32));
    std::vector<std::thread> running;
    for (int t = 0; t < threads; t++)
      running.emplace_back([=] {
        threadIdx.x = t, blockIdx.x = b, blockDim.x = threads;
        kernel();
      });
    for (auto& each : running) each.join();
  }
}

extern "C" void forward(int steps, int n, void** p) {
  launch(n / SEQUENCES, [=] {
    forward_window(steps, n, (int16*)p[0], (int8*)p[1], (int*)p[2], (int*)p[3], (int8*)p[4], (int*)p[5],
                   (int*)p[6], (int*)p[7], (int*)p[8], (int*)p[9], (int*)p[10], (int*)p[11], (int*)p[12],
                   (int*)p[13], (int*)p[14], (int*)p[15], (int*)p[16], (int*)p[17], (int*)p[18], (bf16*)p[19],
                   (unsigned long long*)p[20]);
  });
}
extern "C" void outputs(int steps, int n, void** p) {
  for (int i = 0; i < n * OUTPUTS; i++) {
    threadIdx.x = i, blockIdx.x = 0, blockDim.x = n * OUTPUTS;
    backward_outputs(steps, n, (float*)p[0], (int*)p[1], (int*)p[2], (int*)p[3], (float*)p[4], (float*)p[5]);
  }
}
extern "C" void backward(int steps, int n, void** p) {
  launch(n / SEQUENCES, [=] {
    backward_window(steps, n, (int16*)p[0], (int8*)p[1], (int*)p[2], (float*)p[3], (float*)p[4], (float*)p[5],
                    (float*)p[6], (float*)p[7], (float*)p[8], (float*)p[9], (float*)p[10], (int*)p[11],
                    (int*)p[12], (int*)p[13], (int*)p[14], (int*)p[15], (float*)p[16], (bf16*)p[17],
                    (float*)p[18]);
  });
}
