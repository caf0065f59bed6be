"""C++ that native code of Warp kernels begins with: three numbers as a vector, and functions that processors work out in lanes.

A loop over the lanes of a block, which clang turns into vector instructions, must be straight code: no jumps, no calls that are not
inlined, no values that are returned in registers side by side. So functions are lambdas, polynomials stand for those of the C
library, and structures say how they are copied, for then they are handed on by address, and the optimiser takes them apart.
"""

from __future__ import annotations

from string import Template


def native(*parts: str, **constants: float) -> str:
    """``parts`` of a function's body one after another, with numbers in place of ``$NAME``."""
    return Template("".join(parts)).substitute({name: repr(value) for name, value in constants.items()})


LANES = 16
"""How many items native code takes at once on a CPU, one of AVX-512's registers of floats; on a GPU every thread takes one."""
WIDTH = """
#if defined(__CUDA_ARCH__)
    const int lanes = 1;
#else
    const int lanes = $LANES;
#endif
"""
MATH = """
    struct Vec {
        float x, y, z;
        Vec(float x, float y, float z) : x(x), y(y), z(z) {}
        Vec(const Vec& from) : x(from.x), y(from.y), z(from.z) {}
        Vec operator+(Vec other) const { return Vec(x + other.x, y + other.y, z + other.z); }
        Vec operator-(Vec other) const { return Vec(x - other.x, y - other.y, z - other.z); }
        Vec operator*(float factor) const { return Vec(x * factor, y * factor, z * factor); }
        float dot(Vec other) const { return x * other.x + y * other.y + z * other.z; }
    };
    const float pi = 3.14159265358979323846f;
    const auto least = [](float a, float b) { return a < b ? a : b; };
    const auto most = [](float a, float b) { return a > b ? a : b; };
    const auto within = [](int x, int count) { return x < 0 ? 0 : x < count ? x : count - 1; };
    const auto unit = [most](Vec a) { return a * (1.0f / ::sqrtf(most(a.dot(a), 1.0e-20f))); };  // zero stays zero
    const auto fraction = [](double x) {  // of x beyond whole numbers, below 1 even as a float
        const double rest = x - ::floor(x), below = 1.0 - 1.0 / 16777216.0;
        return rest < below ? rest : below;
    };
    const auto turned = [pi](float turns) {  // cosine and sine of 2 pi turns in [-2, 2], to 1e-7, within an eighth of a turn
        const float quarter = ::floorf(4.0f * turns + 0.5f);
        const float x = (4.0f * turns - quarter) * (0.5f * pi), x2 = x * x;
        const float sine = x * (1.0f - x2 * (1.0f / 6.0f - x2 * (1.0f / 120.0f - x2 * (1.0f / 5040.0f - x2 * (1.0f / 362880.0f)))));
        const float cosine = 1.0f - x2 * (0.5f - x2 * (1.0f / 24.0f - x2 * (1.0f / 720.0f - x2 * (1.0f / 40320.0f))));
        const bool odd = ((int)quarter & 1) == 1;
        const float sign = ((int)quarter & 2) == 2 ? -1.0f : 1.0f;
        return Vec(sign * (odd ? -sine : cosine), sign * (odd ? cosine : sine), 0.0f);
    };
    const auto arc_cosine = [pi](float x) {  // in [0, pi], for x in [-1, 1], to 4e-7 (Abramowitz and Stegun, 4.4.46)
        const float a = ::fabsf(x);
        float p = -0.0012624911f;
        p = p * a + 0.0066700901f;
        p = p * a - 0.0170881256f;
        p = p * a + 0.0308918810f;
        p = p * a - 0.0501743046f;
        p = p * a + 0.0889789874f;
        p = p * a - 0.2145988016f;
        p = p * a + 0.5f * pi;  // 2e-8 more than the source has, so that the equator is where it is
        const float angle = ::sqrtf(1.0f - a) * p;
        return x >= 0.0f ? angle : pi - angle;
    };
    const auto arc_tangent = [pi, most, least](float y, float x) {  // of (x, y) in [-pi, pi], to 4e-7 (4.4.49, smaller over larger)
        const float far = most(::fabsf(x), ::fabsf(y)), t = least(::fabsf(x), ::fabsf(y)) / most(far, 1.0e-30f), t2 = t * t;
        float p = 0.0028662257f;
        p = p * t2 - 0.0161657367f;
        p = p * t2 + 0.0429096138f;
        p = p * t2 - 0.0752896400f;
        p = p * t2 + 0.1065626393f;
        p = p * t2 - 0.1420889944f;
        p = p * t2 + 0.1999355085f;
        p = p * t2 - 0.3333314528f;
        float angle = t + t * t2 * p;
        angle = ::fabsf(y) > ::fabsf(x) ? 0.5f * pi - angle : angle;
        angle = x < 0.0f ? pi - angle : angle;
        return 1.0f / y < 0.0f ? -angle : angle;  // minus zero is below
    };
"""
