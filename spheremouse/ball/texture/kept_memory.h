// Large arrays in memory that is kept when they end: the system clears new pages, which takes longer than a kernel.
#pragma once

#include <cstdlib>
#include <map>
#include <mutex>
#include <new>

#include "spheremouse/native/arrays.h"

namespace spheremouse::ball {

/// Blocks of memory without an owner, by size.
class KeptMemory {
    static constexpr size_t MOST_BYTES = 32 << 20;  // kept at most
    static constexpr size_t HEAD = 64;              // bytes before the array, with its size; a line of the cache
    std::mutex mutex_;
    std::multimap<size_t, void*> free_;
    size_t bytes_ = 0;

  public:
    /// The only one. It lasts as long as the process, since arrays may end after the module.
    static KeptMemory& instance() {
        static auto* all = new KeptMemory();
        return *all;
    }

    void* take(size_t bytes) {
        void* block = nullptr;
        {
            const std::lock_guard lock(mutex_);
            if (const auto found = free_.find(bytes); found != free_.end()) {
                block = found->second;
                free_.erase(found);
                bytes_ -= bytes;
            }
        }
        if (block == nullptr) block = std::malloc(bytes + HEAD);
        if (block == nullptr) throw std::bad_alloc();
        *static_cast<size_t*>(block) = bytes;
        return static_cast<char*>(block) + HEAD;
    }

    void give_back(void* array) {
        void* block = static_cast<char*>(array) - HEAD;
        const size_t bytes = *static_cast<size_t*>(block);
        const std::lock_guard lock(mutex_);
        if (bytes_ + bytes > MOST_BYTES) return std::free(block);
        free_.emplace(bytes, block);
        bytes_ += bytes;
    }
};

/// A new array of NumPy with any content.
template <class T>
struct KeptArray {
    T* data;
    nb::object array;

    explicit KeptArray(std::initializer_list<size_t> shape) {
        size_t bytes = sizeof(T);
        for (size_t n : shape) bytes *= n;
        data = static_cast<T*>(KeptMemory::instance().take(bytes));
        const nb::capsule owner(data, [](void* p) noexcept { KeptMemory::instance().give_back(p); });
        array = nb::cast(nb::ndarray<nb::numpy, T>(data, shape.size(), shape.begin(), owner));
    }
};

}  // namespace spheremouse::ball
