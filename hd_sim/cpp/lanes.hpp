// Lanes: joints are computed two at a time with the compiler's vector types, one at a time for a single joint.
//
// Sine, cosine and exponential are written here once for both, so that the same inputs give the same bits on every
// machine and C library. Accuracy: 1-2 ulp. Domain: |x| < 1e6 rad for sin_cos, x <= 0 for exp_negative.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace hd_sim {

using Pair = double __attribute__((vector_size(16)));
using PairBits = std::uint64_t __attribute__((vector_size(16)));

template <class V>
using BitsOf = std::conditional_t<std::is_same_v<V, double>, std::uint64_t, PairBits>;

// How `N` joints are laid out: V is the vector type, `padded` the length of every array.
template <int N>
struct Lanes {
    using V = std::conditional_t<N == 1, double, Pair>;
    static constexpr int width = N == 1 ? 1 : 2;
    static constexpr int padded = (N + width - 1) / width * width;
};

template <class To, class From>
inline To bits_as(const From& from) {
    static_assert(sizeof(To) == sizeof(From));
    To to;
    std::memcpy(&to, &from, sizeof(to));
    return to;
}

template <class V>
inline V load(const double* from) {
    V value;
    std::memcpy(&value, from, sizeof(value));
    return value;
}

template <class V>
inline void store(double* to, const V& value) {
    std::memcpy(to, &value, sizeof(value));
}

template <class V>
inline V all(double x) {
    if constexpr (std::is_same_v<V, double>) {
        return x;
    } else {
        return V{x, x};
    }
}

// mask (all ones or all zeros per lane) ? a : b
template <class V>
inline V choose(const BitsOf<V>& mask, const V& a, const V& b) {
    using Bits = BitsOf<V>;
    return bits_as<V>(static_cast<Bits>((mask & bits_as<Bits>(a)) | (~mask & bits_as<Bits>(b))));
}

template <class V>
inline BitsOf<V> below(const V& a, const V& b) {  // a < b
    if constexpr (std::is_same_v<V, double>) {
        return a < b ? ~std::uint64_t{0} : std::uint64_t{0};
    } else {
        return reinterpret_cast<PairBits>(a < b);
    }
}

template <class V>
inline V magnitude(const V& x) {
    using Bits = BitsOf<V>;
    return bits_as<V>(static_cast<Bits>(bits_as<Bits>(x) & std::uint64_t{0x7fffffffffffffff}));
}

constexpr double ROUND = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to a whole number in the low bits

template <class V>
inline void sin_cos(const V& x, V& sine, V& cosine) {
    using Bits = BitsOf<V>;
    const V shifted = x * 0.63661977236758134308 + ROUND;  // 2/pi
    const Bits quadrant = bits_as<Bits>(shifted);
    const V n = shifted - ROUND;
    // pi/2 in three parts of at most 33 bits, so that the products are exact
    const V r =
        ((x - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    const V z = r * r;
    const V s = r + r * z *
                        (-1.66666666666666324348e-01 +
                         z * (8.33333333332248946124e-03 +
                              z * (-1.98412698298579493134e-04 +
                                   z * (2.75573137070700676789e-06 +
                                        z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const V c = 1.0 - 0.5 * z +
                z * z *
                    (4.16666666666666019037e-02 +
                     z * (-1.38888888888741095749e-03 +
                          z * (2.48015872894767294178e-05 +
                               z * (-2.75573143513906633035e-07 +
                                    z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    const Bits odd = ~(quadrant & 1) + 1;  // all ones if odd
    const V sine_here = choose(odd, c, s), cosine_here = choose(odd, s, c);
    sine = bits_as<V>(static_cast<Bits>(bits_as<Bits>(sine_here) ^ ((quadrant & 2) << 62)));
    cosine = bits_as<V>(static_cast<Bits>(bits_as<Bits>(cosine_here) ^ (((quadrant + 1) & 2) << 62)));
}

// exp(x) for x <= 0; below -700 the result is exp(-700), which is 0 for every use here.
template <class V>
inline V exp_negative(const V& x) {
    using Bits = BitsOf<V>;
    const V low = all<V>(-700.0);
    const V y = choose(below(x, low), low, x);
    const V shifted = y * 1.44269504088896338700 + ROUND;  // 1/ln 2
    const V n = shifted - ROUND;
    const V r = (y - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    const V p =
        1.0 +
        r * (1.0 + r * (1.0 / 2 +
                        r * (1.0 / 6 +
                             r * (1.0 / 24 +
                                  r * (1.0 / 120 +
                                       r * (1.0 / 720 +
                                            r * (1.0 / 5040 +
                                                 r * (1.0 / 40320 +
                                                      r * (1.0 / 362880 +
                                                           r * (1.0 / 3628800 +
                                                                r * (1.0 / 39916800 + r * (1.0 / 479001600))))))))))));
    return bits_as<V>(static_cast<Bits>(bits_as<Bits>(p) + (bits_as<Bits>(shifted) << 52)));
}

}  // namespace hd_sim
