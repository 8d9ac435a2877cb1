// C++17 over trocar_plugin.h, header-only: a component is a struct, its ports are fields, its commands are
// methods.
//
// Invariant: positions are looked up by name in the manifest and sizes compared with it, so manifest and code
// cannot drift apart unnoticed; no exception leaves the tables (trocar::Refused is the author's answer,
// anything else counts as a panic).
//
//   TROCAR_MANIFEST(R"json({...})json");
//   struct LowPass : trocar::Component {
//       trocar::In<Force> raw;
//       trocar::Out<Force> filtered;
//       void step(const trocar_tick &tick) override { Force x; if (raw.fresh(x)) filtered.write(x); }
//       static void members(trocar::Members<LowPass> &m) { m.input("raw", &LowPass::raw); ... }
//   };
//   TROCAR_PLUGIN(trocar::class_<LowPass>("low_pass"))
#ifndef TROCAR_PLUGIN_HPP
#define TROCAR_PLUGIN_HPP

#include "trocar_frames.hpp"
#include "trocar_guard.hpp"
#include "trocar_json.hpp"
#include "trocar_repeated.hpp"
#include "trocar_sizes.hpp"
#include "trocar_values.hpp"

#include <algorithm>
#include <cstring>
#include <exception>
#include <functional>
#include <initializer_list>
#include <memory>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

namespace trocar {

// An input of plain samples; unbound until the host ties it.
template <class T> class In {
    static_assert(std::is_trivially_copyable_v<T>, "samples are plain data");

  public:
    // The newest sample when it was not seen before.
    bool fresh(T &value) { return take(value, false) && (view_.flags & TROCAR_SAMPLE_FRESH) != 0; }
    // The newest sample, seen or not.
    bool latest(T &value) { return take(value, false); }
    // Each sample once, in order (an input with "fifo").
    bool next(T &value) { return take(value, true); }
    // Of the sample taken last, ns.
    uint64_t stamp() const { return view_.stamp_ns; }
    bool stale() const { return (view_.flags & TROCAR_SAMPLE_STALE) != 0; }
    void tie(const trocar_in *slot) { slot_ = slot; }

  private:
    bool take(T &value, bool next) {
        if (slot_ == nullptr) return false;
        view_ = {};
        view_.struct_size = sizeof view_;
        const int32_t there = (next ? slot_->next : slot_->latest)(slot_->ctx, &view_);
        if (there != TROCAR_IN_SAMPLE || view_.header == nullptr) return false;
        std::memcpy(&value, view_.header, sizeof value);
        return true;
    }
    const trocar_in *slot_ = nullptr;
    trocar_sample view_ = {};
};

// An output of plain samples.
template <class T> class Out {
    static_assert(std::is_trivially_copyable_v<T>, "samples are plain data");

  public:
    // Publishes a copy; stamp in ns of the host's clock.
    trocar_outcome write(const T &value, uint64_t stamp_ns) {
        return slot_ == nullptr ? static_cast<trocar_outcome>(TROCAR_UNBOUND)
                                : slot_->write(slot_->ctx, &value, stamp_ns);
    }
    void tie(const trocar_out *slot) { slot_ = slot; }

  private:
    const trocar_out *slot_ = nullptr;
};

// Stands for no argument, no result, no payload.
struct None {};

// A function of a required interface.
template <class A = None, class R = None> class Function {
  public:
    // Never waits: the way from step.
    trocar_outcome send(const A &arg = {}) { return ask(arg, nullptr, nullptr); }
    // Likewise, and it never runs if it was not begun within deadline_ns (0: its connection and server say
    // how long).
    trocar_outcome send(const A &arg, uint64_t deadline_ns) {
        trocar_call_opts opts = {};
        opts.struct_size = sizeof opts;
        opts.mode = TROCAR_MODE_SEND;
        opts.deadline_ns = deadline_ns;
        return ask(arg, nullptr, &opts);
    }
    // Waits for the result, at most deadline_ns (0 = the connection's own, never more than an hour).
    trocar_outcome call(const A &arg, R &ret, uint64_t deadline_ns = 0) {
        trocar_call_opts opts = {};
        opts.struct_size = sizeof opts;
        opts.mode = TROCAR_MODE_CALL;
        opts.deadline_ns = deadline_ns;
        return ask(arg, &ret, &opts);
    }
    void tie(const trocar_fn *slot) { slot_ = slot; }

  private:
    trocar_outcome ask(const A &arg, R *ret, trocar_call_opts *opts) {
        if (slot_ == nullptr) return TROCAR_UNBOUND;
        const void *a = std::is_empty_v<A> ? nullptr : static_cast<const void *>(&arg);
        return slot_->call(slot_->ctx, a, std::is_empty_v<R> ? nullptr : static_cast<void *>(ret), opts);
    }
    const trocar_fn *slot_ = nullptr;
};

// An event of a provided interface.
template <class T = None> class Event {
  public:
    trocar_outcome emit(const T &payload = {}) {
        if (slot_ == nullptr) return TROCAR_UNBOUND;
        return slot_->emit(slot_->ctx, std::is_empty_v<T> ? nullptr : static_cast<const void *>(&payload));
    }
    void tie(const trocar_event *slot) { slot_ = slot; }

  private:
    const trocar_event *slot_ = nullptr;
};

// Base of an author's component; override what you need. Throw Refused to say no with a sentence: from
// configure the component is as it was before, so change nothing until all is checked; a command or read has
// failed for its caller and nothing else happens; from start, stop, resume, make_safe and step the component
// is in FAULT. Refused(why, TROCAR_STATUS_FAILED) from configure puts it in FAULT as well, and so does every
// other exception wherever it comes from.
struct Component {
    const trocar_host *host = nullptr;
    std::string name;

    virtual ~Component() = default;
    virtual void configure(const Json &) {}
    virtual void start() {}
    virtual void stop() {}
    virtual void resume() {}
    // With "safe_from_any_thread" in the manifest this runs beside an entry that hangs, and beside itself:
    // touch only std::atomic members and handles made for several threads, and wait for no mutex that another
    // entry holds.
    virtual void make_safe() {}
    virtual void step(const trocar_tick &) {}
    virtual void answered(uint64_t, const Json &) {}
    // Ports that change: the whole description, {"types": [...], "class": {...}}, what the manifest names
    // first and in its order, then inputs, outputs, functions and events beyond it. Asked after configure and
    // after ports_changed().
    virtual std::string describe() { return std::string(); }
    // With describe: the slots, in the order of what it wrote last; those of the manifest are tied already.
    virtual void bound(const trocar_ports &) {}
    // What must survive a swap and is not in the state.
    virtual std::string snapshot() { return std::string(); }
    virtual void restored(std::string_view) {}
    // Any thread. DISABLED on a host older than ABI 1.1.
    trocar_outcome ports_changed() const {
        const bool there = host->struct_size >= offsetof(trocar_host, ports_changed) + sizeof host->ports_changed;
        return there ? host->ports_changed(host->ctx) : static_cast<trocar_outcome>(TROCAR_DISABLED);
    }
    // A dynamic component service as JSON; the reply comes to answered under the same token. Not from step.
    trocar_outcome service(uint64_t token, std::string_view json) const {
        return host->service(host->ctx, token, {reinterpret_cast<const uint8_t *>(json.data()), json.size()});
    }
    uint64_t now_ns() const { return host->now_ns(host->ctx); }

  private:
    template <class C> friend class Table;
    // What ids beyond the manifest mean: by the last describe, and since the last bind.
    Beyond described_, in_force_;
};

// The members of class C, each at its position in the manifest.
template <class C> class Members {
  public:
    // Made of a class in the manifest; types are those of the whole.
    Members(const Json &manifest, const Json &types) : manifest_(manifest), types_(types), sizes_(types) {
        inputs.resize(manifest["inputs"].items().size());
        outputs.resize(manifest["outputs"].items().size());
        functions.resize(count("required", "functions"));
        handlers.resize(count("required", "handlers"));
        commands.resize(count("provided", "commands"));
        reads.resize(commands.size());
        events.resize(count("provided", "events"));
    }

    template <class T> void input(std::string_view name, In<T> C::*port) {
        sizes_.same_port(name, port_of("inputs", name)["type"], "plain", bytes_of<T>());
        put(inputs, port_at("inputs", name), name) = [port](C &c, const trocar_in *slot) { (c.*port).tie(slot); };
    }
    template <class T> void output(std::string_view name, Out<T> C::*port) {
        sizes_.same_port(name, port_of("outputs", name)["type"], "plain", bytes_of<T>());
        put(outputs, port_at("outputs", name), name) = [port](C &c, const trocar_out *slot) { (c.*port).tie(slot); };
    }
    template <class H> void input(std::string_view name, FrameIn<H> C::*port) {
        sizes_.same_port(name, port_of("inputs", name)["type"], "frame", bytes_of<H>());
        put(inputs, port_at("inputs", name), name) = [port](C &c, const trocar_in *slot) { (c.*port).tie(slot); };
    }
    template <class H> void output(std::string_view name, FrameOut<H> C::*port) {
        sizes_.same_port(name, port_of("outputs", name)["type"], "frame", bytes_of<H>());
        put(outputs, port_at("outputs", name), name) = [port](C &c, const trocar_out *slot) { (c.*port).tie(slot); };
    }
    // Names of members are "interface/member".
    template <class A, class R> void function(std::string_view name, Function<A, R> C::*port) {
        const Json &told = member_of("required", "functions", name);
        if (told["any"].boolean()) throw Refused(std::string(name) + ": a function of any type is tied in bound()");
        sizes_.same(name, "argument", told["arg"], bytes_of<A>());
        sizes_.same(name, "result", told["ret"], bytes_of<R>());
        put(functions, member_at("required", "functions", name), name) =
            [port](C &c, const trocar_fn *slot) { (c.*port).tie(slot); };
    }
    template <class T> void event(std::string_view name, Event<T> C::*port) {
        sizes_.same(name, "payload", member_of("provided", "events", name)["payload"], bytes_of<T>());
        put(events, member_at("provided", "events", name), name) =
            [port](C &c, const trocar_event *slot) { (c.*port).tie(slot); };
    }
    // void f(), void f(A), R f(), R f(A).
    template <class R, class... A> void command(std::string_view name, R (C::*f)(A...)) {
        same_command(name, bytes_of_all<A...>(), bytes_of<R>());
        put(commands, member_at("provided", "commands", name), name) = [f](C &c, const void *arg, void *ret) {
            answer<R, A...>([&](auto &&...a) -> R { return (c.*f)(a...); }, arg, ret);
        };
    }
    // R f(const State &), R f(const State &, A): a pure function of one published row.
    template <class R, class S, class... A> void read(std::string_view name, R (*f)(const S &, A...)) {
        static_assert(std::is_trivially_copyable_v<S>, "the state is plain data");
        same_command(name, bytes_of_all<A...>(), bytes_of<R>());
        sizes_.same(name, "state", manifest_["state"], bytes_of<S>());
        put(reads, member_at("provided", "commands", name), name) = [f](const void *row, const void *arg, void *ret) {
            S state{};
            if (row != nullptr) std::memcpy(&state, row, sizeof state);
            answer<R, A...>([&](auto &&...a) -> R { return f(state, a...); }, arg, ret);
        };
    }
    template <class... A> void on(std::string_view name, void (C::*f)(A...)) {
        sizes_.same(name, "payload", member_of("required", "handlers", name)["payload"], bytes_of_all<A...>());
        put(handlers, member_at("required", "handlers", name), name) = [f](C &c, const void *arg) {
            answer<void, A...>([&](auto &&...a) { (c.*f)(a...); }, arg, nullptr);
        };
    }
    // Members of interfaces that describe writes once for each name of a list, "arm_{}/move_jp": the first
    // parameter says which one is meant, from 0 in the order of the description. R f(size_t), R f(size_t, A).
    template <class R, class... A> void each_command(std::string_view name, R (C::*f)(size_t, A...)) {
        repeated.command(name, bytes_of_all<A...>(), bytes_of<R>(), [f](C &c, size_t each, const void *arg, void *ret) {
            answer<R, A...>([&](auto &&...a) -> R { return (c.*f)(each, a...); }, arg, ret);
        });
    }
    // R f(const State &, size_t), R f(const State &, size_t, A). A class with these has one repeated provided
    // interface, and its description the members in the order they are given here.
    template <class R, class S, class... A> void each_read(std::string_view name, R (*f)(const S &, size_t, A...)) {
        static_assert(std::is_trivially_copyable_v<S>, "the state is plain data");
        sizes_.same(name, "state", manifest_["state"], bytes_of<S>());
        repeated.read(name, bytes_of_all<A...>(), bytes_of<R>(), [f](const void *row, size_t each, const void *arg, void *ret) {
            S state{};
            if (row != nullptr) std::memcpy(&state, row, sizeof state);
            answer<R, A...>([&](auto &&...a) -> R { return f(state, each, a...); }, arg, ret);
        });
    }
    template <class... A> void each_on(std::string_view name, void (C::*f)(size_t, A...)) {
        repeated.handler(name, bytes_of_all<A...>(), [f](C &c, size_t each, const void *arg) {
            answer<void, A...>([&](auto &&...a) { (c.*f)(each, a...); }, arg, nullptr);
        });
    }
    // The state block, published after each entry.
    template <class S> void state(S C::*field) {
        static_assert(std::is_trivially_copyable_v<S>, "the state is plain data");
        sizes_.same("the state block", "state", manifest_["state"], bytes_of<S>());
        state_size = sizeof(S);
        state_of = [field](C &c) -> void * { return &(c.*field); };
    }

    std::vector<std::function<void(C &, const trocar_in *)>> inputs;
    std::vector<std::function<void(C &, const trocar_out *)>> outputs;
    std::vector<std::function<void(C &, const trocar_fn *)>> functions;
    std::vector<std::function<void(C &, const trocar_event *)>> events;
    std::vector<std::function<void(C &, const void *, void *)>> commands;
    std::vector<std::function<void(const void *, const void *, void *)>> reads;
    std::vector<std::function<void(C &, const void *)>> handlers;
    Repeated<C> repeated;
    std::function<void *(C &)> state_of;
    size_t state_size = 0;

    const Json &manifest() const { return manifest_; }
    const Json &types() const { return types_; }

    // Everything the manifest names must have been given.
    void check() const {
        complete("inputs", inputs);
        complete("outputs", outputs);
        complete("functions", functions);
        complete("handlers", handlers);
        complete("events", events);
        for (size_t i = 0; i < commands.size(); ++i)
            if (!commands[i] && !reads[i]) fail("a command", i);
        if (manifest_["state"].is_null() != (state_size == 0)) {
            throw Refused("manifest and code differ: only one of them has a state");
        }
        if (!repeated.empty() && std::is_same_v<decltype(&C::describe), std::string (Component::*)()>) {
            throw Refused("members of repeated interfaces are given, and the class has no describe that names them");
        }
    }

  private:
    size_t count(const char *side, const char *kind) const {
        size_t n = 0;
        for (const Json &i : manifest_[side].items()) n += i[kind].items().size();
        return n;
    }
    size_t port_at(const char *kind, std::string_view name) const {
        size_t at = 0;
        for (const Json &p : manifest_[kind].items()) {
            if (p["name"].string() == name) return at;
            ++at;
        }
        throw Refused("the manifest has no " + std::string(name) + " among the " + kind);
    }
    size_t member_at(const char *side, const char *kind, std::string_view name) const {
        size_t at = 0;
        for (const Json &i : manifest_[side].items()) {
            for (const Json &m : i[kind].items()) {
                if (i["name"].string() + "/" + m["name"].string() == name) return at;
                ++at;
            }
        }
        throw Refused("the manifest has no " + std::string(name) + " among the " + kind);
    }
    const Json &port_of(const char *kind, std::string_view name) const {
        return manifest_[kind].items()[port_at(kind, name)];
    }
    const Json &member_of(const char *side, const char *kind, std::string_view name) const {
        size_t at = member_at(side, kind, name);
        for (const Json &i : manifest_[side].items()) {
            if (at < i[kind].items().size()) return i[kind].items()[at];
            at -= i[kind].items().size();
        }
        throw Refused("the manifest has no " + std::string(name));
    }
    void same_command(std::string_view name, size_t arg, size_t ret) const {
        const Json &told = member_of("provided", "commands", name);
        sizes_.same(name, "argument", told["arg"]["type"], arg);
        sizes_.same(name, "result", told["ret"], ret);
    }
    template <class V> typename V::value_type &put(V &all, size_t at, std::string_view name) {
        if (all[at]) throw Refused(std::string(name) + " is given twice");
        return all[at];
    }
    template <class V> static void complete(const char *what, const V &all) {
        for (size_t i = 0; i < all.size(); ++i)
            if (!all[i]) fail(what, i);
    }
    [[noreturn]] static void fail(const char *what, size_t at) {
        throw Refused("manifest and code differ: nothing is given for " + std::string(what) + " at position " +
                      std::to_string(at));
    }

    const Json &manifest_;
    const Json &types_;
    const Sizes sizes_;
};

// The table of class C. Made once; members that do not fit the manifest are why init, and create, refuse.
template <class C> class Table {
    static_assert(std::is_base_of_v<Component, C>, "a component derives from trocar::Component");

  public:
    static const trocar_class *make(const Json &manifest, const Json &types) {
        static const std::string name = manifest["name"].string();
        static std::unique_ptr<Members<C>> made;
        wrong_ = guarded_text([&] {
            made = std::make_unique<Members<C>>(manifest, types);
            C::members(*made);
            made->check();
        });
        members_ = made.get();
        static trocar_class table = {};
        table.struct_size = sizeof table;
        table.name = bytes(name);
        table.create = create;
        table.destroy = [](void *self) { guarded(nullptr, [&] { delete of(self); }); };
        table.configure = [](void *self, trocar_bytes json, trocar_err *err) {
            return guarded(err, [&] { of(self)->configure(json.len == 0 ? Json() : Json::parse(text(json))); },
                           TROCAR_STATUS_INVALID);
        };
        table.bind = bind;
        table.start = [](void *self, trocar_err *err) { return guarded(err, [&] { of(self)->start(); }); };
        table.stop = [](void *self, trocar_err *err) { return guarded(err, [&] { of(self)->stop(); }); };
        table.resume = [](void *self, trocar_err *err) { return guarded(err, [&] { of(self)->resume(); }); };
        table.make_safe = [](void *self, trocar_err *err) { return guarded(err, [&] { of(self)->make_safe(); }); };
        table.step = [](void *self, const trocar_tick *tick, trocar_err *err) {
            return guarded(err, [&] { of(self)->step(*tick); });
        };
        table.command = [](void *self, uint32_t id, const void *arg, void *ret, trocar_err *err) {
            return guarded(err, [&] {
                C &c = *of(self);
                const size_t fixed = members_->commands.size();
                if (id < fixed) return at(members_->commands, id)(c, arg, ret);
                members_->repeated.run(c, base(c).in_force_, id - fixed, arg, ret);
            });
        };
        table.read = [](const void *row, uint32_t id, const void *arg, void *ret, trocar_err *err) {
            return guarded(err, [&] {
                const size_t fixed = members_->reads.size();
                if (id < fixed) return at(members_->reads, id)(row, arg, ret);
                members_->repeated.look(row, id - fixed, arg, ret);
            });
        };
        table.on_event = [](void *self, uint32_t id, const void *payload, trocar_err *err) {
            return guarded(err, [&] {
                C &c = *of(self);
                const size_t fixed = members_->handlers.size();
                if (id < fixed) return at(members_->handlers, id)(c, payload);
                members_->repeated.handle(c, base(c).in_force_, id - fixed, payload);
            });
        };
        table.on_service = [](void *self, uint64_t token, trocar_bytes reply) {
            return guarded(nullptr, [&] { of(self)->answered(token, Json::parse(text(reply))); });
        };
        if (members_ != nullptr && members_->state_size > 0) {
            table.state_copy = [](void *self, void *dst, size_t len) {
                std::memcpy(dst, members_->state_of(*of(self)), std::min(len, members_->state_size));
            };
        }
        table.restore = restore;
        table.snapshot = [](void *self, const trocar_sink *sink) {
            return guarded(nullptr, [&] { tell(sink, of(self)->snapshot()); });
        };
        if (describes()) {
            table.describe = [](void *self, const trocar_sink *sink) {
                return guarded(nullptr, [&] {
                    const std::string said = of(self)->describe();
                    look_up(*of(self), said);
                    tell(sink, said);
                });
            };
        }
        return &table;
    }
    // Why it can make none; empty when it can.
    static const std::string &wrong() { return wrong_; }

  private:
    static C *of(void *self) { return static_cast<C *>(self); }
    static Component &base(C &c) { return c; }

    // What the ids of a new description mean; describe has no place for a sentence, so it goes to the log.
    static void look_up(C &c, const std::string &said) {
        if (members_->repeated.empty()) return;
        try {
            base(c).described_ = members_->repeated.of(said.empty() ? Json() : Json::parse(said), members_->manifest());
        } catch (const Refused &e) {
            if (c.host->log != nullptr) c.host->log(c.host->ctx, TROCAR_LOG_ERROR, bytes("describe"), bytes(e.what()));
            throw;
        }
    }

    // The class has a describe of its own.
    static constexpr bool describes() {
        return !std::is_same_v<decltype(&C::describe), std::string (Component::*)()>;
    }

    static void tell(const trocar_sink *sink, const std::string &said) {
        if (!said.empty()) sink->write(sink->ctx, bytes(said));
    }

    static void *create(const trocar_host *host, trocar_bytes instance, trocar_err *err) {
        C *self = nullptr;
        guarded(err, [&] {
            if (!wrong_.empty()) throw Refused(wrong_);
            auto made = std::make_unique<C>();
            made->host = host;
            made->name = std::string(text(instance));
            self = made.release();
        });
        return self;
    }

    static trocar_status bind(void *self, const trocar_ports *ports, trocar_err *err) {
        return guarded(err, [&] {
            const Members<C> &m = *members_;
            const auto fits = [](size_t have, size_t want) { return describes() ? have >= want : have == want; };
            if (!fits(ports->input_count, m.inputs.size()) || !fits(ports->output_count, m.outputs.size()) ||
                !fits(ports->function_count, m.functions.size()) || !fits(ports->event_count, m.events.size())) {
                throw Refused("the host binds other counts of ports than the manifest has", TROCAR_STATUS_INVALID);
            }
            C &c = *of(self);
            for (size_t i = 0; i < m.inputs.size(); ++i) m.inputs[i](c, ports->inputs[i]);
            for (size_t i = 0; i < m.outputs.size(); ++i) m.outputs[i](c, ports->outputs[i]);
            for (size_t i = 0; i < m.functions.size(); ++i) m.functions[i](c, ports->functions[i]);
            for (size_t i = 0; i < m.events.size(); ++i) m.events[i](c, ports->events[i]);
            base(c).in_force_ = base(c).described_;
            c.bound(*ports);
        });
    }

    static trocar_status restore(void *self, trocar_bytes state, trocar_bytes snapshot, trocar_err *err) {
        return guarded(err, [&] {
            if (state.len != 0 && state.len != members_->state_size) {
                throw Refused("the state block is not of this class", TROCAR_STATUS_INVALID);
            }
            if (state.len != 0) std::memcpy(members_->state_of(*of(self)), state.ptr, state.len);
            of(self)->restored(text(snapshot));
        });
    }

    template <class V> static const typename V::value_type &at(const V &all, uint32_t id) {
        if (id >= all.size() || !all[id]) throw Refused("this class has no such id", TROCAR_STATUS_UNSUPPORTED);
        return all[id];
    }
    template <class F> static std::string guarded_text(F &&f) {
        try {
            f();
            return std::string();
        } catch (const std::exception &e) {
            return e.what();
        }
    }

    static inline std::string wrong_;
    static inline const Members<C> *members_ = nullptr;
};

// A class by its name in the manifest.
struct ClassOf {
    std::string_view name;
    const trocar_class *(*make)(const Json &manifest, const Json &types);
    const std::string &(*wrong)();
};
template <class C> ClassOf class_(std::string_view name) { return {name, Table<C>::make, Table<C>::wrong}; }

// The plugin of a manifest, its classes in the manifest's order whatever order they are given in.
class Plugin {
  public:
    Plugin(const char *manifest, std::initializer_list<ClassOf> given, trocar_status (*init)(const trocar_host *))
        : manifest_(Json::parse(manifest)) {
        for (const Json &c : manifest_["classes"].items()) {
            for (const ClassOf &one : given) {
                if (one.name != c["name"].string()) continue;
                classes_.push_back(one.make(c, manifest_["types"]));
                if (!one.wrong().empty()) wrong_ += (wrong_.empty() ? "class " : "; class ") + c["name"].string() + ": " + one.wrong();
            }
        }
        table_.init = init;
        table_.struct_size = sizeof table_;
        table_.abi_major = TROCAR_ABI_MAJOR;
        table_.abi_minor = TROCAR_ABI_MINOR;
        table_.name = bytes(manifest_["name"].string());
        table_.version = bytes(manifest_["version"].string());
        table_.class_count = static_cast<uint32_t>(classes_.size());
        table_.classes = classes_.data();
    }
    const trocar_plugin *table() const { return &table_; }
    // A plugin whose code and manifest differ is refused before anything of it runs.
    trocar_status init(const trocar_host *host) const {
        if (wrong_.empty()) return TROCAR_STATUS_OK;
        if (host != nullptr && host->log != nullptr) host->log(host->ctx, TROCAR_LOG_ERROR, bytes("init"), bytes(wrong_));
        return TROCAR_STATUS_INVALID;
    }

  private:
    Json manifest_;
    std::string wrong_;
    std::vector<const trocar_class *> classes_;
    trocar_plugin table_ = {};
};

} // namespace trocar

// The exported function, after TROCAR_MANIFEST: TROCAR_PLUGIN(trocar::class_<LowPass>("low_pass"), ...)
#define TROCAR_PLUGIN(...)                                                                                         \
    static trocar_status trocar_plugin_init(const trocar_host *host);                                              \
    static const trocar::Plugin &trocar_plugin_whole() {                                                           \
        static const trocar::Plugin plugin(trocar_manifest_note.desc, {__VA_ARGS__}, trocar_plugin_init);          \
        return plugin;                                                                                             \
    }                                                                                                              \
    static trocar_status trocar_plugin_init(const trocar_host *host) { return trocar_plugin_whole().init(host); }  \
    TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) {                                                    \
        try {                                                                                                      \
            return trocar_plugin_whole().table();                                                                  \
        } catch (...) {                                                                                            \
            return nullptr;                                                                                        \
        }                                                                                                          \
    }

#endif
