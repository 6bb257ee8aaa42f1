// Memory of the core, owned by C++; errors of the core as exceptions; conversion of arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "ek/arena.h"
#include "ek/se2.h"

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace nb = nanobind;

// One namespace per precision: both modules are loaded in one process, and C++ identifies types by name.
namespace EK_NAME(binding) {

using Points = nb::ndarray<const ek_real, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const ek_real, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Row = std::tuple<double, double, double>;

// Raise ValueError with the core's message.
inline void require(ek_status status, const char *what)
{
    if (status != EK_OK) {
        throw std::invalid_argument(std::string(what) + ": " + ek_status_text(status));
    }
}

// MemoryError with the number of bytes.
class NotFree : public std::bad_alloc {
public:
    explicit NotFree(std::size_t bytes) : text_(std::to_string(bytes) + " bytes of memory are not free") {}
    const char *what() const noexcept override { return text_.c_str(); }

private:
    std::string text_;
};

class Memory {
public:
    Memory() = default;

    // Measure what `init(arena)` needs, allocate it, and initialise. `scattered`: it is read in no order, and large pages
    // save the processor from looking their addresses up.
    template <typename LayOut> Memory(const char *what, LayOut init, bool scattered = false)
    {
        ek_arena arena = ek_arena_make(nullptr, 0);
        require(init(&arena), what);
        const std::size_t bytes = std::max<std::size_t>(arena.used, 1);
        bytes_.reset(static_cast<unsigned char *>(::operator new(bytes, alignment, std::nothrow)));
        if (!bytes_) {
            throw NotFree(bytes);
        }
        if (scattered) {
            use_large_pages(bytes_.get(), bytes);
        }
        arena = ek_arena_make(bytes_.get(), bytes);
        require(init(&arena), what);
        require(ek_arena_check(&arena), what);
    }

private:
    static constexpr std::align_val_t alignment{EK_ARENA_LINE};

    // Ask for large pages within the bytes; where there are none, nothing changes.
    static void use_large_pages(unsigned char *start, std::size_t bytes)
    {
#ifdef __linux__
        constexpr std::size_t page = std::size_t{1} << 21;
        const std::size_t skipped = (page - reinterpret_cast<std::uintptr_t>(start) % page) % page;
        if (bytes >= skipped + page) {
            madvise(start + skipped, (bytes - skipped) / page * page, MADV_HUGEPAGE);
        }
#endif
    }

    struct Free {
        void operator()(unsigned char *bytes) const { ::operator delete(bytes, alignment); }
    };
    std::unique_ptr<unsigned char, Free> bytes_;
};

inline ek_pose pose_of(const Row &row)
{
    return {ek_real(std::get<0>(row)), ek_real(std::get<1>(row)), ek_real(std::get<2>(row))};
}

inline Row row_of(ek_pose pose) { return {pose.x, pose.y, pose.theta}; }

// Convert a Python integer to 32 bits; saturate, the core then checks the range.
inline int32_t whole(int64_t number) { return int32_t(std::clamp<int64_t>(number, INT32_MIN, INT32_MAX)); }
inline uint32_t natural(int64_t number) { return uint32_t(std::clamp<int64_t>(number, 0, INT32_MAX)); }

// Start of an array, never NULL: the core refuses NULL even for zero points.
template <typename Array> const ek_real *start_of(const Array &array)
{
    static const ek_real nothing = 0;
    return array.shape(0) > 0 ? array.data() : &nothing;
}

// A NumPy array that owns the numbers.
template <typename Number> nb::object array_of(std::vector<Number> &&numbers, std::array<std::size_t, 2> shape)
{
    auto kept = std::make_unique<std::vector<Number>>(std::move(numbers));
    kept->reserve(1); // data() of an empty array must not be NULL
    Number *const start = kept->data();
    nb::capsule owner(kept.get(), [](void *vector) noexcept { delete static_cast<std::vector<Number> *>(vector); });
    kept.release();
    return nb::cast(nb::ndarray<nb::numpy, Number>(start, shape.size(), shape.data(), owner));
}

} // namespace EK_NAME(binding)
