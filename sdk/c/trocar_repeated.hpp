// Members of interfaces that exist once for each name of a list, and how pointers of an entry become a call.
//
// Invariant: an id beyond the manifest means what the description in force says: describe looks the names up,
// bind puts what it found in force. Reads know no instance, so their ids follow from the order in which the
// members are given.
#ifndef TROCAR_REPEATED_HPP
#define TROCAR_REPEATED_HPP

#include "trocar_json.hpp"
#include "trocar_sizes.hpp"

#include <cstring>
#include <functional>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <vector>

namespace trocar {

template <class R, class F> void give(F &&f, void *ret) {
    if constexpr (std::is_void_v<R>) {
        (void)ret;
        f();
    } else {
        static_assert(std::is_trivially_copyable_v<R>, "results are plain data");
        const R value = f();
        if (ret != nullptr) std::memcpy(ret, &value, sizeof value);
    }
}

// Calls f with the argument there is, and hands back its result.
template <class R, class... A, class F> void answer(F &&f, const void *arg, void *ret) {
    static_assert(sizeof...(A) <= 1, "at most one argument: put several values into one struct");
    if constexpr (sizeof...(A) == 0) {
        (void)arg;
        give<R>(f, ret);
    } else {
        using Arg = std::decay_t<std::tuple_element_t<0, std::tuple<A...>>>;
        static_assert(std::is_trivially_copyable_v<Arg>, "arguments are plain data");
        if (arg == nullptr) throw Refused("the call carries no argument", TROCAR_STATUS_INVALID);
        Arg value{};
        std::memcpy(&value, arg, sizeof value);
        give<R>([&]() -> R { return f(value); }, ret);
    }
}

// Meaning of an id beyond the manifest: a member, and its interface, counted in the order of the description.
struct Place {
    size_t member;
    size_t each;
};
struct Beyond {
    std::vector<Place> commands, handlers;
};

// Members that class C offers and handles in interfaces with {} in their name. Names of members are
// "interface_{}/member".
template <class C> class Repeated {
  public:
    using Command = std::function<void(C &, size_t, const void *, void *)>;
    using Read = std::function<void(const void *, size_t, const void *, void *)>;
    using Handler = std::function<void(C &, size_t, const void *)>;

    void command(std::string_view name, size_t arg, size_t ret, Command run) {
        add(provided_, name, arg, ret).command = std::move(run);
    }
    void read(std::string_view name, size_t arg, size_t ret, Read run) {
        add(provided_, name, arg, ret).read = std::move(run);
        reads_ = true;
    }
    void handler(std::string_view name, size_t payload, Handler run) {
        add(required_, name, payload, 0).handler = std::move(run);
    }
    bool empty() const { return provided_.empty() && required_.empty(); }

    // The ids of a description beyond the manifest's.
    Beyond of(const Json &description, const Json &manifest) const {
        Beyond out;
        const Json &now = description["class"];
        const auto beyond = [&](const char *side) {
            const std::vector<Json> &all = now[side].items();
            const size_t fixed = std::min(manifest[side].items().size(), all.size());
            return std::vector<Json>(all.begin() + static_cast<std::ptrdiff_t>(fixed), all.end());
        };
        const std::vector<Json> provided = beyond("provided"), required = beyond("required");
        const Sizes sizes(description["types"]);
        places(out.commands, provided_, provided, "commands", sizes);
        places(out.handlers, required_, required, "handlers", sizes);
        if (reads_) in_order(provided);
        return out;
    }

    void run(C &c, const Beyond &in_force, size_t id, const void *arg, void *ret) const {
        if (id >= in_force.commands.size()) unknown();
        const Place place = in_force.commands[id];
        const Command &command = provided_[place.member].command;
        if (!command) unknown();
        command(c, place.each, arg, ret);
    }
    void handle(C &c, const Beyond &in_force, size_t id, const void *arg) const {
        if (id >= in_force.handlers.size()) unknown();
        const Place place = in_force.handlers[id];
        required_[place.member].handler(c, place.each, arg);
    }
    void look(const void *row, size_t id, const void *arg, void *ret) const {
        if (provided_.empty() || !provided_[id % provided_.size()].read) unknown();
        provided_[id % provided_.size()].read(row, id / provided_.size(), arg, ret);
    }

  private:
    // Which interfaces, and the member's own name; one of the three functions is there.
    struct Member {
        std::string before, after, name;
        // Bytes of the argument or payload, and of the result.
        size_t arg, ret;
        Command command;
        Read read;
        Handler handler;

        bool of(const std::string &interface) const {
            return interface.size() > before.size() + after.size() && interface.compare(0, before.size(), before) == 0 &&
                   interface.compare(interface.size() - after.size(), after.size(), after) == 0;
        }
        std::string path() const { return before + "{}" + after + "/" + name; }
    };

    static Member &add(std::vector<Member> &all, std::string_view path, size_t arg, size_t ret) {
        const size_t each = path.find("{}"), slash = path.find('/');
        if (each == path.npos || slash == path.npos || slash < each) {
            throw Refused(std::string(path) + " names no member of a repeated interface, such as arm_{}/move_jp");
        }
        Member made;
        made.arg = arg;
        made.ret = ret;
        made.before = std::string(path.substr(0, each));
        made.after = std::string(path.substr(each + 2, slash - each - 2));
        made.name = std::string(path.substr(slash + 1));
        for (const Member &other : all)
            if (other.path() == made.path()) throw Refused(std::string(path) + " is given twice");
        all.push_back(std::move(made));
        return all.back();
    }

    static void places(std::vector<Place> &out, const std::vector<Member> &known, const std::vector<Json> &interfaces,
                       const char *kind, const Sizes &sizes) {
        for (size_t i = 0; i < interfaces.size(); ++i) {
            for (const Json &m : interfaces[i][kind].items()) {
                const size_t member = find(known, interfaces[i]["name"].string(), m["name"].string());
                const bool told = known[member].handler != nullptr;
                sizes.same(known[member].path(), told ? "payload" : "argument", told ? m["payload"] : m["arg"]["type"],
                           known[member].arg);
                sizes.same(known[member].path(), "result", m["ret"], known[member].ret);
                size_t each = 0;
                for (size_t before = 0; before < i; ++before)
                    each += known[member].of(interfaces[before]["name"].string()) ? 1 : 0;
                out.push_back({member, each});
            }
        }
    }

    static size_t find(const std::vector<Member> &known, const std::string &interface, const std::string &name) {
        std::string there;
        for (size_t i = 0; i < known.size(); ++i) {
            if (known[i].of(interface) && known[i].name == name) return i;
            there += (i == 0 ? "" : ", ") + known[i].path();
        }
        throw Refused("describe names " + interface + "/" + name + ", which this class has not; there are " +
                      (there.empty() ? "none" : there));
    }

    // With reads: one repeated interface, whose members the description has in the order they were given.
    void in_order(const std::vector<Json> &interfaces) const {
        for (const Json &i : interfaces) {
            const std::vector<Json> &commands = i["commands"].items();
            bool same = commands.size() == provided_.size();
            for (size_t m = 0; same && m < commands.size(); ++m)
                same = provided_[m].of(i["name"].string()) && provided_[m].name == commands[m]["name"].string();
            if (!same) {
                throw Refused("describe: a class with repeated reads has one repeated provided interface, with all its "
                              "commands in the order they were given; " + i["name"].string() + " differs");
            }
        }
    }

    [[noreturn]] static void unknown() { throw Refused("this class has no such id", TROCAR_STATUS_UNSUPPORTED); }

    std::vector<Member> provided_, required_;
    bool reads_ = false;
};

} // namespace trocar

#endif
