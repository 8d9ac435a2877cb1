// Payload types of variable length, text of up to N bytes and lists of up to N items, as the manifest's
// {"text":N} and {"list":T,"n":N}; and the time between two stamps.
//
// Invariant: the length is never above N and what lies behind it is zero, so equal values have equal bytes.
#ifndef TROCAR_VALUES_HPP
#define TROCAR_VALUES_HPP

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string_view>
#include <type_traits>

namespace trocar {

// {"text":N}: UTF-8. N is a multiple of 8, so that nothing in a struct needs padding.
template <size_t N> struct Text {
    static_assert(N > 0 && N % 8 == 0, "a text has room for a multiple of 8 bytes");
    uint64_t len;
    char room[N];

    std::string_view view() const { return {room, static_cast<size_t>(std::min<uint64_t>(len, N))}; }
    // False when it is too long; then nothing has changed.
    bool set(std::string_view text) {
        if (text.size() > N) return false;
        std::memset(room, 0, N);
        std::memcpy(room, text.data(), text.size());
        len = text.size();
        return true;
    }
};

// {"list":T,"n":N}.
template <class T, size_t N> struct List {
    static_assert(std::is_trivially_copyable_v<T>, "items are plain data");
    static_assert(N > 0 && N * sizeof(T) % 8 == 0, "the room of a list is a multiple of 8 bytes");
    uint64_t len;
    T room[N];

    size_t size() const { return static_cast<size_t>(std::min<uint64_t>(len, N)); }
    const T *begin() const { return room; }
    const T *end() const { return room + size(); }
    const T &operator[](size_t i) const { return room[i]; }
    T &operator[](size_t i) { return room[i]; }
    // False when there is no room; then nothing has changed.
    bool push(const T &item) {
        if (len >= N) return false;
        room[len++] = item;
        return true;
    }
    void clear() {
        std::memset(static_cast<void *>(room), 0, sizeof room);
        len = 0;
    }
};

static_assert(sizeof(Text<64>) == 72 && sizeof(List<double, 16>) == 136, "a length of 8 bytes and the room");

// Seconds by which stamp `later` is after stamp `earlier` (ns): the time between two samples, for filters.
// Nothing where the stamps do not tell it: one of them is 0 (the first sample has none before it), they are
// equal, or in the other order.
inline std::optional<double> seconds_after(uint64_t later, uint64_t earlier) {
    if (earlier == 0 || later <= earlier) return std::nullopt;
    return static_cast<double>(later - earlier) * 1e-9;
}

} // namespace trocar

#endif
