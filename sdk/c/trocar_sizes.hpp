// Sizes of the types of a manifest, to compare them with the code before any of it runs.
//
// Invariant: the host moves as many bytes as the manifest says, so a member of another size would read or
// write what lies behind it.
#ifndef TROCAR_SIZES_HPP
#define TROCAR_SIZES_HPP

#include "trocar_json.hpp"

#include <string>
#include <string_view>
#include <type_traits>

namespace trocar {

// Bytes of T as the host moves it: a struct without members stands for nothing.
template <class T> constexpr size_t bytes_of() {
    if constexpr (std::is_void_v<T>) {
        return 0;
    } else {
        return std::is_empty_v<T> ? 0 : sizeof(T);
    }
}
template <class... A> constexpr size_t bytes_of_all() {
    return (size_t{0} + ... + bytes_of<std::decay_t<A>>());
}

// The types of a manifest, or of a description.
class Sizes {
  public:
    explicit Sizes(const Json &types) : types_(types) {}

    // Bytes of a type as it is written there; null takes none.
    size_t of(const Json &type, int depth = 0) const {
        if (type.is_null()) return 0;
        const size_t n = static_cast<size_t>(type["n"].number());
        if (depth > 16) throw Refused("a type of the manifest lies too deep", TROCAR_STATUS_INVALID);
        if (!type["array"].is_null()) return n * of(type["array"], depth + 1);
        if (!type["list"].is_null()) return 8 + n * of(type["list"], depth + 1);
        if (!type["text"].is_null()) return 8 + static_cast<size_t>(type["text"].number());
        if (!type["ref"].is_null()) return named(type["ref"].string());
        return plain(type.string());
    }

    // The code's size of a member is the manifest's.
    void same(std::string_view member, const char *part, const Json &type, size_t code) const {
        const size_t told = of(type);
        if (told == code) return;
        throw Refused(std::string(member) + ": the " + part + " has " + std::to_string(code) + " bytes in the code and " +
                          std::to_string(told) + " in the manifest: let both name the same type, and build it again",
                      TROCAR_STATUS_INVALID);
    }

    // The same for a port: a plain one moves samples, one of frames the header.
    void same_port(std::string_view port, const Json &type, const char *kind, size_t code) const {
        if (type[kind].is_null()) {
            throw Refused(std::string(port) + ": the manifest has no {\"" + kind + "\":…} there, as this kind of port moves; a port " +
                              "of any type is tied in bound()",
                          TROCAR_STATUS_INVALID);
        }
        same(port, kind[0] == 'p' ? "sample" : "header of a frame", type[kind], code);
    }

  private:
    size_t named(const std::string &name) const {
        for (const Json &t : types_.items())
            if (t["name"].string() == name) return static_cast<size_t>(t["size"].number());
        throw Refused("the manifest has no type " + name, TROCAR_STATUS_INVALID);
    }
    static size_t plain(const std::string &name) {
        static const struct {
            const char *name;
            size_t bytes;
        } all[] = {{"bool", 1}, {"u8", 1},  {"i8", 1},  {"u16", 2}, {"i16", 2}, {"u32", 4},
                   {"i32", 4},  {"f32", 4}, {"u64", 8}, {"i64", 8}, {"f64", 8}, {"stamp", 8}};
        for (const auto &one : all)
            if (name == one.name) return one.bytes;
        throw Refused("the manifest has no type " + name, TROCAR_STATUS_INVALID);
    }

    const Json &types_;
};

} // namespace trocar

#endif
