// JSON for C++ plugins: a configuration, the manifest, a service reply; and how an entry refuses.
//
// Invariant: any text either parses or throws Refused with the byte where it stopped; reading what is not
// there gives null. A number is what its digits say in every locale, and whole numbers of 64 bit are exact or
// refused.
#ifndef TROCAR_JSON_HPP
#define TROCAR_JSON_HPP

#include "trocar_plugin.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <locale.h>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace trocar {

// Thrown by an author: the entry refuses, with one sentence.
struct Refused : std::runtime_error {
    // TROCAR_STATUS_OK: what the entry it leaves takes it for.
    trocar_status status;
    explicit Refused(const std::string &why, trocar_status status = TROCAR_STATUS_OK)
        : std::runtime_error(why), status(status) {}
};

inline trocar_bytes bytes(std::string_view text) {
    return {reinterpret_cast<const uint8_t *>(text.data()), text.size()};
}
inline std::string_view text(trocar_bytes b) {
    return b.ptr == nullptr ? std::string_view() : std::string_view(reinterpret_cast<const char *>(b.ptr), b.len);
}

// Numbers are read and written by this one, whatever the process was set to.
inline locale_t plain_locale() {
    static const locale_t plain = newlocale(LC_ALL_MASK, "C", nullptr);
    return plain;
}

// JSON of a value, for a description or a service request: exact, in every locale.
inline std::string written(bool v) { return v ? "true" : "false"; }
template <class T, std::enable_if_t<std::is_integral_v<T> && !std::is_same_v<T, bool>, int> = 0> std::string written(T v) {
    return std::to_string(v);
}
inline std::string written(double v) {
    if (!std::isfinite(v)) throw Refused("JSON has no infinity and no NaN", TROCAR_STATUS_INVALID);
    char digits[32];
    const locale_t before = uselocale(plain_locale());
    std::snprintf(digits, sizeof digits, "%.17g", v);
    uselocale(before);
    return digits;
}
inline std::string written(std::string_view text) {
    std::string out = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') out += '\\';
        if (static_cast<unsigned char>(c) < 0x20) {
            char code[8];
            std::snprintf(code, sizeof code, "\\u%04x", static_cast<unsigned>(c));
            out += code;
        } else {
            out += c;
        }
    }
    return out + '"';
}
inline std::string written(const char *text) { return written(std::string_view(text)); }
inline std::string written(const std::string &text) { return written(std::string_view(text)); }

// A JSON value: the configuration, a service reply, the manifest. What is not there reads as null.
class Json {
  public:
    static Json parse(std::string_view text) {
        Reader r{text, 0};
        Json value = r.value(0);
        r.space();
        if (r.at != text.size()) r.fail();
        return value;
    }

    bool is_null() const { return kind == Kind::Null; }
    // Refused where no double is the number that was given: read that one by i64 or u64.
    double number(double otherwise = 0.0) const {
        if (kind != Kind::Number) return otherwise;
        if (digits && !(std::abs(num) < beyond)) {
            const bool below = negative ? std::abs(num) <= 0x1p63 : num < 0x1p64;
            if (!fits || !below || static_cast<uint64_t>(std::abs(num)) != magnitude) {
                throw Refused(typed + " is not exact as a double: read it by i64() or u64()", TROCAR_STATUS_INVALID);
            }
        }
        return num;
    }
    // A whole number, also one that is given as a text of its digits: exactly, or refused.
    int64_t i64(int64_t otherwise = 0) const {
        if (kind == Kind::Null) return otherwise;
        const Json n = whole();
        const uint64_t most = static_cast<uint64_t>(INT64_MAX) + (n.negative ? 1 : 0);
        if (n.magnitude > most) n.no_whole("from -9223372036854775808 to 9223372036854775807");
        return static_cast<int64_t>(n.negative ? 0 - n.magnitude : n.magnitude);
    }
    uint64_t u64(uint64_t otherwise = 0) const {
        if (kind == Kind::Null) return otherwise;
        const Json n = whole();
        if (n.negative && n.magnitude != 0) n.no_whole("from 0 to 18446744073709551615");
        return n.magnitude;
    }
    bool boolean(bool otherwise = false) const { return kind == Kind::Bool ? num != 0.0 : otherwise; }
    const std::string &string() const { return str; }
    const std::vector<Json> &items() const { return list; }
    const Json &operator[](std::string_view key) const {
        static const Json null;
        for (size_t i = 0; i < keys.size(); ++i)
            if (keys[i] == key) return list[i];
        return null;
    }

  private:
    enum class Kind { Null, Bool, Number, Text, List, Object };
    Kind kind = Kind::Null;
    double num = 0.0;
    // A number as it was typed; digits and a sign alone; then how much they say, if it fits.
    std::string typed;
    bool digits = false, negative = false, fits = false;
    uint64_t magnitude = 0;
    // From here on, not each whole number is a double.
    static constexpr double beyond = 0x1p53;
    std::string str;
    std::vector<std::string> keys; // of an object, beside `list`
    std::vector<Json> list;

    void number_of(const std::string &text) {
        typed = text;
        char *stop = nullptr;
        num = strtod_l(text.c_str(), &stop, plain_locale());
        if (text.empty() || *stop != '\0' || !std::isfinite(num)) {
            throw Refused(text + " is no number of JSON", TROCAR_STATUS_INVALID);
        }
        kind = Kind::Number;
        negative = text[0] == '-';
        const size_t first = negative || text[0] == '+' ? 1 : 0;
        digits = text.find_first_not_of("0123456789", first) == text.npos;
        fits = digits;
        for (size_t i = first; digits && i < text.size(); ++i) {
            const uint64_t digit = static_cast<uint64_t>(text[i] - '0');
            fits = fits && magnitude <= (UINT64_MAX - digit) / 10;
            magnitude = magnitude * 10 + digit;
        }
    }
    // This as a whole number: 5, 5.0, 5e3 and "5", but no double that may have been another number.
    Json whole() const {
        Json n = *this;
        if (kind == Kind::Text && !str.empty() && str.find_first_not_of("-0123456789") == str.npos) n.number_of(str);
        if (n.kind != Kind::Number) throw Refused("a whole number is wanted" + quoting(str), TROCAR_STATUS_INVALID);
        if (!n.digits) {
            if (!(std::abs(n.num) < beyond) || n.num != std::floor(n.num)) n.no_whole("written with its digits alone");
            n.negative = n.num < 0;
            n.magnitude = static_cast<uint64_t>(std::abs(n.num));
        } else if (!n.fits) {
            n.no_whole("of 64 bit");
        }
        return n;
    }
    [[noreturn]] void no_whole(const char *which) const {
        throw Refused(typed + " is no whole number " + which, TROCAR_STATUS_INVALID);
    }
    static std::string quoting(const std::string &text) { return text.empty() ? text : ", and \"" + text + "\" is none"; }

    struct Reader {
        std::string_view text;
        size_t at;

        [[noreturn]] void fail() const {
            throw Refused("JSON is not understood at byte " + std::to_string(at), TROCAR_STATUS_INVALID);
        }
        void space() {
            while (at < text.size() && std::strchr(" \t\r\n", text[at]) != nullptr && text[at] != '\0') ++at;
        }
        char peek() {
            space();
            return at < text.size() ? text[at] : '\0';
        }
        void expect(char c) {
            if (peek() != c) fail();
            ++at;
        }
        bool word(std::string_view w) {
            if (text.substr(at, w.size()) != w) return false;
            at += w.size();
            return true;
        }
        Json value(int depth) {
            Json v;
            const char c = peek();
            if (depth > 64) fail();
            if (c == '{' || c == '[') {
                const char end = c == '{' ? '}' : ']';
                v.kind = c == '{' ? Kind::Object : Kind::List;
                ++at;
                while (peek() != end) {
                    if (!v.list.empty()) expect(',');
                    if (c == '{') {
                        peek();
                        v.keys.push_back(quoted());
                        expect(':');
                    }
                    v.list.push_back(value(depth + 1));
                }
                ++at;
            } else if (c == '"') {
                v.kind = Kind::Text;
                v.str = quoted();
            } else if (word("true") || word("false")) {
                v.kind = Kind::Bool;
                v.num = text[at - 2] == 'u' ? 1.0 : 0.0;
            } else if (!word("null")) {
                const size_t end = std::min(text.find_first_not_of("+-0123456789.eE", at), text.size());
                if (end == at) fail();
                v.number_of(std::string(text.substr(at, end - at)));
                at = end;
            }
            return v;
        }
        std::string quoted() {
            expect('"');
            std::string out;
            for (;;) {
                if (at >= text.size()) fail();
                const char c = text[at++];
                if (c == '"') return out;
                if (c != '\\') {
                    out += c;
                    continue;
                }
                if (at >= text.size()) fail();
                const char e = text[at++];
                static const char from[] = "\"\\/bfnrt", to[] = "\"\\/\b\f\n\r\t";
                if (e == 'u') {
                    unicode(out);
                } else if (const char *p = std::strchr(from, e); p != nullptr && e != '\0') {
                    out += to[p - from];
                } else {
                    fail();
                }
            }
        }
        // One \uXXXX as UTF-8; halves of a pair, which settings never need, become U+FFFD.
        void unicode(std::string &out) {
            const std::string hex(text.substr(at, 4));
            if (hex.size() != 4 || hex.find_first_not_of("0123456789abcdefABCDEF") != hex.npos) fail();
            unsigned long code = std::strtoul(hex.c_str(), nullptr, 16);
            at += 4;
            if (code >= 0xD800 && code < 0xE000) code = 0xFFFD;
            if (code < 0x80) {
                out += static_cast<char>(code);
            } else if (code < 0x800) {
                out += static_cast<char>(0xC0 | (code >> 6));
                out += static_cast<char>(0x80 | (code & 63));
            } else {
                out += static_cast<char>(0xE0 | (code >> 12));
                out += static_cast<char>(0x80 | ((code >> 6) & 63));
                out += static_cast<char>(0x80 | (code & 63));
            }
        }
    };
};

} // namespace trocar

#endif
