// JSON for C++ plugins: a configuration, the manifest, a service reply; and how an entry refuses.
//
// Invariant: any text either parses or throws Refused with the byte where it stopped; reading what is not there gives null.
#ifndef TROCAR_JSON_HPP
#define TROCAR_JSON_HPP

#include "trocar_plugin.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
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
    double number(double otherwise = 0.0) const { return kind == Kind::Number ? num : otherwise; }
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
    std::string str;
    std::vector<std::string> keys; // of an object, beside `list`
    std::vector<Json> list;

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
                const std::string digits(text.substr(at, end - at));
                char *stop = nullptr;
                v.num = std::strtod(digits.c_str(), &stop);
                if (digits.empty() || *stop != '\0') fail();
                v.kind = Kind::Number;
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
            char *stop = nullptr;
            unsigned long code = std::strtoul(hex.c_str(), &stop, 16);
            if (hex.size() != 4 || *stop != '\0') fail();
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
