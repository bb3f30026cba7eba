// Att-SNN on an NVIDIA GPU: the integer forward pass and the surrogate-gradient backward pass of a window.
//
// A block runs SEQUENCES copies of the network through all steps. Warp w holds rows 16 w ... 16 w + 15 of the
// weights of both layers in registers, as operands of the tensor cores, and each of its threads the states of
// 2 neurons in 2 sequences: rows `row`, `row + 8` by sequences 2 (lane % 4), + 1. Spikes go from step to step
// through shared memory. Time first; H0, H1 (multiples of 32), INPUTS and OUTPUTS are compile-time constants.
//
// The steps are those of estimators/networks/forward.py; state units are 2^-14.

typedef signed char int8;
typedef unsigned char uint8;
typedef short int16;
typedef unsigned short bf16;  // its bits
typedef unsigned int uint32;

#define SEQUENCES 8
#define SOURCES (H0 + H1)
#define WARPS ((H0 > H1 ? H0 : H1) / 16)
#define THRESHOLD 8192
#define V_MAX 8388607
#define OUTPUT_THRESHOLD (131071 * 64)
#define MANT_MAX 4095
#define SPIKE_ROW (SOURCES + 16)   // bytes; rows of 4 more banks each, so that a warp's loads do not collide
#define GRAD_ROW (H1 + 8)          // bf16
#define SHARED_WEIGHTS (H1 > 128)   // of the encoding layer, where registers do not hold them
#define READ (OUTPUTS > 4 ? 8 : 4)  // floats for the outputs of a sequence

__device__ __forceinline__ int decay(int x, uint32 k) {  // k: 4096 τ, shifted left by 20
  int size = (int)__umulhi((uint32)(x < 0 ? -x : x), k);
  return x < 0 ? -size : size;
}
__device__ __forceinline__ int wrap21(int x) { return (int)((uint32)x << 10) >> 10; }
__device__ __forceinline__ int wrap23(int x) { return (int)((uint32)x << 8) >> 8; }
__device__ __forceinline__ int shift4(int x) { return x < 0 ? -((-x) >> 4) : x >> 4; }  // toward zero
__device__ __forceinline__ int clipped(int x, int most) { return x > most ? most : (x < -most ? -most : x); }

__device__ __forceinline__ bf16 to_bf16(float x) {  // to nearest, ties to even
  uint32 bits = __float_as_uint(x);
  return (bf16)((bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16);
}
__device__ __forceinline__ float from_bf16(bf16 x) { return __uint_as_float((uint32)x << 16); }

#ifndef EMULATED
__device__ __forceinline__ void mma_int8(int* c, const uint32* a, uint32 b0, uint32 b1) {
  asm volatile(
      "mma.sync.aligned.m16n8k32.row.col.s32.s8.s8.s32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
      : "+r"(c[0]), "+r"(c[1]), "+r"(c[2]), "+r"(c[3])
      : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
}
__device__ __forceinline__ void mma_bf16(float* c, const uint32* a, uint32 b0, uint32 b1) {
  asm volatile(
      "mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
      : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
      : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
}
#endif

// Operand A of 16 rows by 32 columns of a row-major int8 matrix.
__device__ __forceinline__ void load_int8(uint32* a, const int8* w, int stride, int rows, int row, int column) {
  int lane = threadIdx.x % 32, g = lane / 4, t = lane % 4;
  for (int part = 0; part < 4; part++) {
    int r = row + g + 8 * (part % 2), c = column + 4 * t + 16 * (part / 2);
    a[part] = r < rows ? *(const uint32*)(w + r * stride + c) : 0u;
  }
}
// Operand A of 16 rows by 16 columns of the transpose of a row-major int8 matrix, in state units, as bf16.
__device__ __forceinline__ void load_transposed(
    uint32* a, const int8* w, int stride, int row, int column, const int* shifts) {
  int lane = threadIdx.x % 32, g = lane / 4, t = lane % 4;
  for (int part = 0; part < 4; part++) {
    int r = row + g + 8 * (part % 2), c = column + 2 * t + 8 * (part / 2);
    uint32 low = to_bf16((float)(w[c * stride + r] * (1 << shifts[c])));
    uint32 high = to_bf16((float)(w[(c + 1) * stride + r] * (1 << shifts[c + 1])));
    a[part] = low | (high << 16);
  }
}

// Sum over the 4 threads of a neuron, in a fixed order.
__device__ __forceinline__ void write_sum(float* to, float x) {
  x += __shfl_xor_sync(0xffffffffu, x, 1);
  x += __shfl_xor_sync(0xffffffffu, x, 2);
  if (threadIdx.x % 4 == 0) *to = x;
}

// Trace, row 0 before the window: u, v of each layer int32 (T + 1, n, h), after-spike currents a1 of the hidden
// one; spikes (T + 1, n, SOURCES) bf16. w: mantissas / 2, (H1, SOURCES), times 2^shift state units, shifts
// (2, H1) of the encoding and the hidden layer's spikes; w_after (H1) state units; w_out (OUTPUTS, H1); w_in
// (H0, INPUTS) mantissas. k*: 4096 τ. x (T, n, 8) in 1/1024. totals: spikes of both layers.
extern "C" __global__ void __launch_bounds__(WARPS * 32, 1) forward_window(
    const int steps, const int n, const int16* __restrict__ x, const int8* __restrict__ w,
    const int* __restrict__ shifts, const int* __restrict__ w_after,
    const int8* __restrict__ w_out, const int* __restrict__ w_in, const int* __restrict__ k_syn0,
    const int* __restrict__ k_mem0, const int* __restrict__ k_syn1, const int* __restrict__ k_mem1,
    const int* __restrict__ k_after, const int* __restrict__ k_out, int* __restrict__ u0, int* __restrict__ v0,
    int* __restrict__ u1, int* __restrict__ v1, int* __restrict__ u2, int* __restrict__ v2, int* __restrict__ a1,
    bf16* __restrict__ spikes, unsigned long long* __restrict__ totals) {
  __shared__ __align__(16) uint8 sent[2][SEQUENCES][SPIKE_ROW];
  const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, g = lane / 4, t4 = lane % 4;
  const int row = 16 * warp + g, first = blockIdx.x * SEQUENCES;
  const bool encodes = 16 * warp < H0, hides = 16 * warp < H1, reads = warp == WARPS - 1;

  uint32 a[SOURCES / 32][4], a_out[H1 / 32][4];
  if (hides)
    for (int k = 0; k < SOURCES / 32; k++) load_int8(a[k], w, SOURCES, H1, 16 * warp, 32 * k);
  if (reads)
    for (int k = 0; k < H1 / 32; k++) load_int8(a_out[k], w_out, H1, OUTPUTS, 0, 32 * k);

  int cu0[4], cv0[4], cu1[4], cv1[4], ca1[4], cu2[4], cv2[4], in[2][INPUTS];
  int by_first[2], by_second[2], own[2];
  uint32 syn0[2], mem0[2], syn1[2], mem1[2], after[2];
  const uint32 syn2 = (uint32)k_out[0] << 20, mem2 = (uint32)k_out[1] << 20;
  for (int r = 0; r < 2; r++) {
    int i = row + 8 * r;
    if (encodes) {
      syn0[r] = (uint32)k_syn0[i] << 20, mem0[r] = (uint32)k_mem0[i] << 20;
      for (int k = 0; k < INPUTS; k++) in[r][k] = w_in[i * INPUTS + k];
    }
    if (hides) {
      syn1[r] = (uint32)k_syn1[i] << 20, mem1[r] = (uint32)k_mem1[i] << 20;
      by_first[r] = 1 << shifts[i], by_second[r] = 1 << shifts[H1 + i];
      own[r] = w_after[i], after[r] = (uint32)k_after[i] << 20;
    }
  }
  for (int c = 0; c < 4; c++) {
    int i = row + 8 * (c / 2), seq = 2 * t4 + c % 2, b = first + seq;
    if (encodes) {
      cu0[c] = u0[b * H0 + i], cv0[c] = v0[b * H0 + i];
      sent[0][seq][i] = cv0[c] > THRESHOLD;
      spikes[b * SOURCES + i] = cv0[c] > THRESHOLD ? 0x3f80 : 0;
    }
    if (hides) {
      cu1[c] = u1[b * H1 + i], cv1[c] = v1[b * H1 + i], ca1[c] = a1[b * H1 + i];
      sent[0][seq][H0 + i] = cv1[c] > THRESHOLD;
      spikes[b * SOURCES + H0 + i] = cv1[c] > THRESHOLD ? 0x3f80 : 0;
    }
    if (reads && g < OUTPUTS && c < 2) cu2[c] = u2[b * OUTPUTS + g], cv2[c] = v2[b * OUTPUTS + g];
  }
  __syncthreads();

  int now = 0, count0 = 0, count1 = 0;
  int4 next[2];
  for (int s = 0; s < 2; s++) next[s] = *(const int4*)(x + (first + 2 * t4 + s) * 8);
  for (int t = 0; t < steps; t++) {
    int4 sample[2] = {next[0], next[1]};
    if (t + 1 < steps)
      for (int s = 0; s < 2; s++) next[s] = *(const int4*)(x + ((long long)(t + 1) * n + first + 2 * t4 + s) * 8);
    int first_sum[4] = {0, 0, 0, 0}, second_sum[4] = {0, 0, 0, 0}, sum_out[4] = {0, 0, 0, 0};
#pragma unroll
    for (int k = 0; k < SOURCES / 32; k++) {
      const uint8* from = &sent[now][g][32 * k + 4 * t4];
      uint32 b0 = *(const uint32*)from, b1 = *(const uint32*)(from + 16);
      if (hides) mma_int8(k < H0 / 32 ? first_sum : second_sum, a[k], b0, b1);
      if (k >= H0 / 32) {
        if (reads) mma_int8(sum_out, a_out[k - H0 / 32], b0, b1);
      }
    }
    const long long at = (long long)(t + 1) * n + first;
#pragma unroll
    for (int c = 0; c < 4; c++) {
      const int r = c / 2, i = row + 8 * r, seq = 2 * t4 + c % 2;
      const long long b = at + seq;
      if (hides) {
        int arriving = wrap21(first_sum[c] * by_first[r] + second_sum[c] * by_second[r]);
        int current = wrap23(decay(cu1[c], syn1[r]) + arriving);
        cu1[c] = current;
        ca1[c] = wrap23(decay(ca1[c], after[r]) + (cv1[c] > THRESHOLD ? own[r] : 0));
        int v = clipped(decay(cv1[c] > THRESHOLD ? 0 : cv1[c], mem1[r]) + current + ca1[c], V_MAX);
        bool spike = v > THRESHOLD;
        cv1[c] = v;
        count1 += spike;
        sent[now ^ 1][seq][H0 + i] = spike;
        spikes[b * SOURCES + H0 + i] = spike ? 0x3f80 : 0;
        u1[b * H1 + i] = cu1[c], v1[b * H1 + i] = v, a1[b * H1 + i] = ca1[c];
      }
      if (encodes) {
        const int16* values = (const int16*)&sample[c % 2];
        int drive = 0;
        for (int k = 0; k < INPUTS; k++) drive += in[r][k] * values[k];
        int current = wrap23(decay(cu0[c], syn0[r]) + shift4(drive));
        int bias = clipped(shift4(current), MANT_MAX) * 16;
        int v = clipped(decay(cv0[c] > THRESHOLD ? 0 : cv0[c], mem0[r]) + bias, V_MAX);
        bool spike = v > THRESHOLD;
        cu0[c] = current, cv0[c] = v;
        count0 += spike;
        sent[now ^ 1][seq][i] = spike;
        spikes[b * SOURCES + i] = spike ? 0x3f80 : 0;
        u0[b * H0 + i] = current, v0[b * H0 + i] = v;
      }
      if (reads && g < OUTPUTS && c < 2) {
        cu2[c] = wrap23(decay(cu2[c], syn2) + wrap21(sum_out[c] * 128));
        int y = decay(cv2[c], mem2) + cu2[c];
        cv2[c] = y > OUTPUT_THRESHOLD ? 0 : (y < -V_MAX ? -V_MAX : y);
        u2[b * OUTPUTS + g] = cu2[c], v2[b * OUTPUTS + g] = cv2[c];
      }
    }
    __syncthreads();
    now ^= 1;
  }
  atomicAdd(totals, (unsigned long long)count0);
  atomicAdd(totals + 1, (unsigned long long)count1);
}

// Gradients. grad2: of the outputs' currents, (T + 1, n, READ) float, row T is 0: of the step that reads a spike.
// du: gradients of the hidden currents as two bf16 each, (T, n, 2, H1), high then low part.
// sums (blocks, ...): per block gradients, see the layout at the end.
extern "C" __global__ void __launch_bounds__(WARPS * 32, 1) backward_window(
    const int steps, const int n, const int16* __restrict__ x, const int8* __restrict__ w,
    const int* __restrict__ shifts, const float* __restrict__ w_after, const float* __restrict__ w_out,
    const float* __restrict__ tau_syn0, const float* __restrict__ tau_mem0, const float* __restrict__ tau_syn1,
    const float* __restrict__ tau_mem1, const float* __restrict__ tau_after,
    const float* __restrict__ costs, const int* __restrict__ u0, const int* __restrict__ v0,
    const int* __restrict__ u1, const int* __restrict__ v1, const int* __restrict__ a1_trace,
    const float* __restrict__ grad2, bf16* __restrict__ du, float* __restrict__ sums) {
#if SHARED_WEIGHTS
#ifndef EMULATED
  extern __shared__ uint4 stored[];
#endif
#endif
  __shared__ __align__(16) bf16 high[2][SEQUENCES][GRAD_ROW];
  __shared__ __align__(16) bf16 low[2][SEQUENCES][GRAD_ROW];
  const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, g = lane / 4, t4 = lane % 4;
  const int row = 16 * warp + g, first = blockIdx.x * SEQUENCES;
  const bool encodes = 16 * warp < H0, hides = 16 * warp < H1;
  const float unit = 1.0f / 16384.0f, width = 20.0f, cost0 = costs[0], cost1 = costs[1];

  uint32 a1[H1 / 16][4];
#if SHARED_WEIGHTS
  uint4* a0 = stored + threadIdx.x;  // operand k of this thread is a0[32 * WARPS * k]
  const int next_operand = 32 * WARPS;
  uint32 part[4];
#else
  uint32 a0[H1 / 16][4];
#endif
  for (int k = 0; k < H1 / 16; k++) {
#if SHARED_WEIGHTS
    if (encodes) {
      load_transposed(part, w, SOURCES, 16 * warp, 16 * k, shifts);
      a0[next_operand * k] = make_uint4(part[0], part[1], part[2], part[3]);
    }
#else
    if (encodes) load_transposed(a0[k], w, SOURCES, 16 * warp, 16 * k, shifts);
#endif
    if (hides) load_transposed(a1[k], w, SOURCES, H0 + 16 * warp, 16 * k, shifts + H1);
  }
  float syn0[2], mem0[2], syn1[2], mem1[2], after[2], own[2], out[2][OUTPUTS];
  float in[2][INPUTS], sum_syn0[2] = {0, 0}, sum_mem0[2] = {0, 0}, sum_syn1[2] = {0, 0}, sum_mem1[2] = {0, 0};
  float sum_after[2] = {0, 0}, sum_own[2] = {0, 0};
  for (int r = 0; r < 2; r++) {
    int i = row + 8 * r;
    if (encodes) syn0[r] = tau_syn0[i], mem0[r] = tau_mem0[i];
    for (int k = 0; k < INPUTS; k++) in[r][k] = 0;
    if (hides) {
      syn1[r] = tau_syn1[i], mem1[r] = tau_mem1[i], after[r] = tau_after[i], own[r] = w_after[i];
      for (int o = 0; o < OUTPUTS; o++) out[r][o] = w_out[o * H1 + i];
    }
  }
  float du0[4] = {0, 0, 0, 0}, dv0[4] = {0, 0, 0, 0}, du1[4] = {0, 0, 0, 0}, dv1[4] = {0, 0, 0, 0};
  float down0[4] = {0, 0, 0, 0}, down1[4] = {0, 0, 0, 0}, da1[4] = {0, 0, 0, 0};
  int now0[4], now1[4], nv0[4], nv1[4], nu0[4], nu1[4], na1[4];  // potentials of this step; of the one before, currents
  int4 next_x[2];
  float4 next_grad[2][READ / 4];

  {
    const long long at = (long long)steps * n + first, before = at - n;
    for (int c = 0; c < 4; c++) {
      const int i = row + 8 * (c / 2), seq = 2 * t4 + c % 2;
      if (encodes) {
        now0[c] = v0[(at + seq) * H0 + i];
        nv0[c] = v0[(before + seq) * H0 + i], nu0[c] = u0[(before + seq) * H0 + i];
      }
      if (hides) {
        now1[c] = v1[(at + seq) * H1 + i];
        nv1[c] = v1[(before + seq) * H1 + i], nu1[c] = u1[(before + seq) * H1 + i];
        na1[c] = a1_trace[(before + seq) * H1 + i];
      }
    }
    for (int s = 0; s < 2; s++) {
      next_x[s] = *(const int4*)(x + (before + 2 * t4 + s) * 8);
      for (int q = 0; q < READ / 4; q++)
        next_grad[s][q] = *(const float4*)(grad2 + (at + 2 * t4 + s) * READ + 4 * q);
    }
  }
  int side = 0;
  for (int t = steps - 1; t >= 0; t--) {
    int pv0[4], pv1[4], pu0[4], pu1[4], pa1[4];
    const int4 sample[2] = {next_x[0], next_x[1]};
    float4 of_output[2][READ / 4];
    for (int s = 0; s < 2; s++)
      for (int q = 0; q < READ / 4; q++) of_output[s][q] = next_grad[s][q];
    for (int c = 0; c < 4; c++) {
      pv0[c] = nv0[c], pv1[c] = nv1[c], pu0[c] = nu0[c], pu1[c] = nu1[c], pa1[c] = na1[c];
    }
    if (t > 0) {  // what the next turn needs
      const long long before = (long long)(t - 1) * n + first;
#pragma unroll
      for (int c = 0; c < 4; c++) {
        const int i = row + 8 * (c / 2);
        const long long b = before + 2 * t4 + c % 2;
        if (encodes) nv0[c] = v0[b * H0 + i], nu0[c] = u0[b * H0 + i];
        if (hides) nv1[c] = v1[b * H1 + i], nu1[c] = u1[b * H1 + i], na1[c] = a1_trace[b * H1 + i];
      }
      for (int s = 0; s < 2; s++) {
        next_x[s] = *(const int4*)(x + (before + 2 * t4 + s) * 8);
        for (int q = 0; q < READ / 4; q++)
          next_grad[s][q] = *(const float4*)(grad2 + (before + n + 2 * t4 + s) * READ + 4 * q);
      }
    }
#pragma unroll
    for (int c = 0; c < 4; c++) {
      const int r = c / 2, i = row + 8 * r, seq = 2 * t4 + c % 2;
      const long long b = (long long)t * n + first + seq;
      if (hides) {
        const float* read = (const float*)of_output[c % 2];
        float ds = down1[c] * unit + cost1 + own[r] * da1[c];  // da1 is of the step after
        for (int o = 0; o < OUTPUTS; o++) ds += read[o] * out[r][o];
        float v = now1[c] * unit, start = pv1[c] > THRESHOLD ? 0.0f : pv1[c] * unit;
        float slope = 1.0f + width * fabsf(v - 0.5f);
        float d = (now1[c] > THRESHOLD ? 0.0f : mem1[r] * dv1[c]) + ds / (slope * slope);
        dv1[c] = d;
        du1[c] = d + syn1[r] * du1[c];
        sum_mem1[r] += d * start;
        sum_syn1[r] += du1[c] * (pu1[c] * unit);
        da1[c] = d + after[r] * da1[c];
        sum_after[r] += da1[c] * (pa1[c] * unit);
        sum_own[r] += pv1[c] > THRESHOLD ? da1[c] : 0.0f;
        bf16 upper = to_bf16(du1[c]), lower = to_bf16(du1[c] - from_bf16(upper));
        high[side][seq][i] = upper, low[side][seq][i] = lower;
        du[(b * 2) * H1 + i] = upper, du[(b * 2 + 1) * H1 + i] = lower;
        now1[c] = pv1[c];
      }
      if (encodes) {
        float ds = down0[c] * unit + cost0;
        float v = now0[c] * unit, start = pv0[c] > THRESHOLD ? 0.0f : pv0[c] * unit;
        float slope = 1.0f + width * fabsf(v - 0.5f);
        float d = (now0[c] > THRESHOLD ? 0.0f : mem0[r] * dv0[c]) + ds / (slope * slope);
        dv0[c] = d;
        du0[c] = d + syn0[r] * du0[c];
        sum_mem0[r] += d * start;
        sum_syn0[r] += du0[c] * (pu0[c] * unit);
        const int16* values = (const int16*)&sample[c % 2];
        for (int k = 0; k < INPUTS; k++) in[r][k] += du0[c] * (values[k] * (1.0f / 1024.0f));
        now0[c] = pv0[c];
      }
    }
    __syncthreads();
    for (int c = 0; c < 4; c++) down0[c] = 0, down1[c] = 0;
#pragma unroll
    for (int k = 0; k < H1 / 16; k++) {
      const bf16 *up = &high[side][g][16 * k + 2 * t4], *lo = &low[side][g][16 * k + 2 * t4];
      uint32 b0 = *(const uint32*)up, b1 = *(const uint32*)(up + 8);
      uint32 c0 = *(const uint32*)lo, c1 = *(const uint32*)(lo + 8);
#if SHARED_WEIGHTS
      if (encodes) {
        const uint4 a = a0[next_operand * k];
        mma_bf16(down0, &a.x, b0, b1), mma_bf16(down0, &a.x, c0, c1);
      }
#else
      if (encodes) mma_bf16(down0, a0[k], b0, b1), mma_bf16(down0, a0[k], c0, c1);
#endif
      if (hides) mma_bf16(down1, a1[k], b0, b1), mma_bf16(down1, a1[k], c0, c1);
    }
    side ^= 1;
  }
  // Per block: (H0, INPUTS + 2) of the encoding layer, then (H1, 4) of the hidden one: τ_syn, τ_mem, w_after, τ_after.
  float* to0 = sums + (long long)blockIdx.x * (H0 * (INPUTS + 2) + H1 * 4);
  float* to1 = to0 + H0 * (INPUTS + 2);
  for (int r = 0; r < 2; r++) {
    int i = row + 8 * r;
    if (encodes) {
      for (int k = 0; k < INPUTS; k++) write_sum(to0 + i * (INPUTS + 2) + k, in[r][k]);
      write_sum(to0 + i * (INPUTS + 2) + INPUTS, sum_syn0[r]);
      write_sum(to0 + i * (INPUTS + 2) + INPUTS + 1, sum_mem0[r]);
    }
    if (hides) {
      write_sum(to1 + i * 4, sum_syn1[r]);
      write_sum(to1 + i * 4 + 1, sum_mem1[r]);
      write_sum(to1 + i * 4 + 2, sum_own[r]);
      write_sum(to1 + i * 4 + 3, sum_after[r]);
    }
  }
}

// Gradients of the outputs' currents into grad2 (T + 1, n, READ), whose row T is 0; of their time constants into
// sums (n, OUTPUTS, 2). grad (T, n, OUTPUTS) of the potentials; u2, v2 as in the trace. A thread an output.
extern "C" __global__ void backward_outputs(
    const int steps, const int n, const float* __restrict__ grad, const int* __restrict__ u2,
    const int* __restrict__ v2, const int* __restrict__ k_out, float* __restrict__ grad2,
    float* __restrict__ sums) {
  const float syn = k_out[0] * (1.0f / 4096.0f), mem = k_out[1] * (1.0f / 4096.0f);
  const int one = blockIdx.x * blockDim.x + threadIdx.x;
  if (one >= n * OUTPUTS) return;
  const int b = one / OUTPUTS, o = one % OUTPUTS, all = n * OUTPUTS;
  float du = 0, dv = 0, sum_syn = 0, sum_mem = 0;
  grad2[((long long)steps * n + b) * READ + o] = 0;
  for (int end = steps; end > 0; end -= 8) {
    float g[8];
    int u[8], v[8];
#pragma unroll
    for (int k = 0; k < 8; k++) {
      long long t = end - 1 - k;
      if (t >= 0) g[k] = grad[t * all + one], u[k] = u2[t * all + one], v[k] = v2[t * all + one];
    }
#pragma unroll
    for (int k = 0; k < 8; k++) {
      long long t = end - 1 - k;
      if (t < 0) break;
      dv = g[k] + mem * dv;
      du = dv + syn * du;
      sum_syn += du * (u[k] * (1.0f / 16384.0f)), sum_mem += dv * (v[k] * (1.0f / 16384.0f));
      grad2[(t * n + b) * READ + o] = du;
    }
  }
  sums[one * 2] = sum_syn, sums[one * 2 + 1] = sum_mem;
}
