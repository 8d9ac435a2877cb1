/* The dlopen boundary between a trocar host and its plugins, for C11 and C++17. The same contract as the Rust crate
 * trocar-plugin-api; a test compares every size and offset.
 *
 * Invariant: append, never edit. A table starts with its struct_size; read an entry only when TROCAR_HAS says that it
 * lies inside. Nothing allocated on one side is freed on the other.
 *
 * A plugin is a shared library with two things in it:
 *   - the manifest, JSON in an ELF note (TROCAR_MANIFEST): what the host shows and checks without running the library;
 *   - the function trocar_plugin_v1 (TROCAR_EXPORT): the tables.
 * Build: g++ -O2 -fPIC -shared -fvisibility=hidden -o libtrocar_NAME.so NAME.cpp
 * Without -fvisibility=hidden, versions of a C++ plugin share their inline statics.
 *
 * Ids are positions in the manifest, counted over all interfaces of the class in order: commands (reads among them) and
 * events over the provided ones, functions and handlers over the required ones.
 *
 * Beside the "type" of an input, output or argument, the "payload" of an event or handler and the "arg" and "ret" of a
 * function, "frame": "retina" says in which coordinate frame it is; "ret_frame" of a command says it of its "ret". It holds
 * for the fields with coordinates, arrays of f64 or f32 in structs, and must agree at Connect where both ends say it.
 *
 * "execution" of a class says how it runs: {"model":"periodic","period_ns":1000000}. A class that is not made
 * for everything else says beside it what it is made for: "models":["periodic","exec_in"], and "min_period_ns"
 * and "max_period_ns" for its period. Create and Configure refuse every other execution with that list, and
 * describe and forms show it.
 *
 * Threads: the host serialises all calls on one instance, but for make_safe of a class whose manifest says
 * "safe_from_any_thread": see there. step, slots and state_copy are the real-time ones: no
 * allocation, no lock, no waiting. read takes no instance and is called from any thread.
 *
 * No exception may leave a function of the tables. */
#ifndef TROCAR_PLUGIN_H
#define TROCAR_PLUGIN_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Version of this contract. A host loads plugins of the same major and of any minor. */
#define TROCAR_ABI_MAJOR 1u
#define TROCAR_ABI_MINOR 2u

/* True when the field lies inside what the table says it has. */
#define TROCAR_HAS(type, table, field) \
    (offsetof(type, field) + sizeof((table)->field) <= (size_t)(table)->struct_size)

/* Result of a class-table entry: 0 is success. */
typedef int32_t trocar_status;
enum {
    TROCAR_STATUS_OK = 0,
    /* The entry failed; the reason is in the error buffer. A command or read has failed for its caller, and nothing else
     * happens; after any other entry the component is in FAULT. */
    TROCAR_STATUS_FAILED = -1,
    /* The entry panicked; the component goes to FAULT and its instance is not trusted again. */
    TROCAR_STATUS_PANICKED = -2,
    /* An argument or the configuration was not acceptable; the reason is in the error buffer. From configure: the component
     * is as it was before. */
    TROCAR_STATUS_INVALID = -3,
    /* The plugin does not implement this id. */
    TROCAR_STATUS_UNSUPPORTED = -4
};

/* Outcome of a call through a slot. Non-negative: done or on its way; negative: exactly one reason why not. */
typedef int32_t trocar_outcome;
enum {
    TROCAR_EXECUTED = 0,
    TROCAR_QUEUED = 1,
    /* No peer is connected. */
    TROCAR_UNBOUND = -1,
    TROCAR_QUEUE_FULL = -2,
    /* Waiting is not allowed on this thread. */
    TROCAR_WOULD_BLOCK = -3,
    /* The command is not among its component's ports any more, or the host takes no more requests for services. */
    TROCAR_DISABLED = -4,
    TROCAR_INVALID_ARGUMENT = -5,
    /* The command ran and failed; the reason is in trocar_call_opts.err. */
    TROCAR_FAILED = -6,
    /* No answer in time; trocar_call_opts.may_still_run tells whether it may still be executed. */
    TROCAR_DEADLINE = -7,
    TROCAR_PEER_LOST = -8,
    TROCAR_NOT_ACTIVE = -9,
    /* The frame pool of an output has no free slot; the frame is dropped and counted. */
    TROCAR_EXHAUSTED = -10
};

/* Borrowed bytes; text is UTF-8 without a terminating zero. ptr may be null only when len is 0. */
typedef struct trocar_bytes {
    const uint8_t *ptr;
    size_t len;
} trocar_bytes;

/* Caller-owned buffer for one sentence of explanation; write at most cap bytes and set len. May be null. */
typedef struct trocar_err {
    uint8_t *ptr;
    size_t cap;
    size_t len;
} trocar_err;

/* A callback that takes bytes; may be called several times, the pieces are concatenated. */
typedef struct trocar_sink {
    void *ctx;
    void (*write)(void *ctx, trocar_bytes bytes);
} trocar_sink;

/* What a step is told about its cycle. All times are ns of the host's monotonic clock. */
typedef struct trocar_tick {
    uint32_t struct_size;
    uint32_t flags;
    /* Cycle number since Start, from 0; skipped cycles are counted too. */
    uint64_t cycle;
    /* When this step began. */
    uint64_t now_ns;
    /* When it should have begun; equals now_ns for executors without a grid. */
    uint64_t deadline_ns;
    /* Nominal period; 0 when the component is not periodic. */
    uint64_t period_ns;
    /* Time since the previous step began; period_ns on the first. */
    uint64_t elapsed_ns;
} trocar_tick;

/* Room for one frame, lent by the pool of an output. */
typedef struct trocar_loan {
    uint32_t struct_size;
    uint32_t flags;
    void *header;
    uint8_t *bytes;
    /* Bytes available behind bytes. */
    uint64_t capacity;
    /* The host's own; handed back unchanged. */
    uint64_t token;
} trocar_loan;

/* Set in trocar_sample.flags when the sample had not been seen by this input before. */
#define TROCAR_SAMPLE_FRESH 1u
/* Set when the sample is older than the connection's max_age, by its stamp or by the time it came. */
#define TROCAR_SAMPLE_STALE 2u

/* One sample or frame, valid until the next latest, next or release on the same input. Set struct_size before asking. */
typedef struct trocar_sample {
    uint32_t struct_size;
    uint32_t flags;
    /* The plain value, or the header of a frame. */
    const void *header;
    const uint8_t *bytes;
    uint64_t len;
    uint64_t stamp_ns;
    /* Counts the writes of the output, from 1; a gap is exactly what was dropped on the way. */
    uint64_t seq;
    /* The host's own; handed back unchanged. */
    uint64_t token;
} trocar_sample;

/* An output. Never waits for a reader. */
typedef struct trocar_out {
    uint32_t struct_size;
    uint32_t flags;
    void *ctx;
    /* Publishes a copy of one plain sample. EXECUTED, or UNBOUND when nobody is connected. */
    trocar_outcome (*write)(void *ctx, const void *value, uint64_t stamp_ns);
    /* Lends room for one frame; EXHAUSTED when every slot is in use (counted). */
    trocar_outcome (*loan)(void *ctx, trocar_loan *loan);
    /* Publishes a loan of which len bytes are filled; the loan is gone afterwards. */
    trocar_outcome (*commit)(void *ctx, trocar_loan *loan, uint64_t len, uint64_t stamp_ns);
    /* Gives a loan back unpublished. */
    void (*cancel)(void *ctx, trocar_loan *loan);
    /* Publishes a frame held by an input as this output, without a copy. */
    trocar_outcome (*forward)(void *ctx, const trocar_sample *sample, uint64_t stamp_ns);
    /* (Re)makes the pool: slots frames of up to max_bytes. From configure and start only. */
    trocar_outcome (*reserve)(void *ctx, uint64_t max_bytes, uint32_t slots);
    /* The type now behind an untyped port, as manifest JSON; STATUS_UNSUPPORTED while unconnected. */
    trocar_status (*type_of)(void *ctx, const trocar_sink *sink);
    /* Since 1.1. As write, for an untyped output: INVALID_ARGUMENT unless value has the size of the type now behind it. */
    trocar_outcome (*write_bytes)(void *ctx, trocar_bytes value, uint64_t stamp_ns);
} trocar_out;

/* Answers of latest and next. */
enum { TROCAR_IN_SAMPLE = 1, TROCAR_IN_EMPTY = 0, TROCAR_IN_UNBOUND = -1 };

/* A frame that is held, whatever becomes of the input, as long as the plugin's own code runs: bytes stay as they are until release,
   which is called once, from any thread; of another process, as long as that is linked to this one. Since 1.2. */
typedef struct trocar_held {
    uint32_t struct_size;
    uint32_t flags;
    const uint8_t *bytes;
    uint64_t len;
    uint64_t token;
    void (*release)(uint64_t token);
} trocar_held;

/* An input. latest gives the newest sample again and again (see FRESH); next gives each once, in order. */
typedef struct trocar_in {
    uint32_t struct_size;
    uint32_t flags;
    void *ctx;
    int32_t (*latest)(void *ctx, trocar_sample *view);
    int32_t (*next)(void *ctx, trocar_sample *view);
    /* Hands the held sample back before the next one is asked for. */
    void (*release)(void *ctx);
    /* Writable bytes of the held frame when this input is its only owner, else null. */
    uint8_t *(*writable)(void *ctx, trocar_sample *view);
    trocar_status (*type_of)(void *ctx, const trocar_sink *sink);
    /* Since 1.1. Bytes of the plain value, or of the header of the frame, in the sample shown last; 0 without one. */
    uint64_t (*header_len)(void *ctx);
    /* Since 1.2. Holds the frame shown last beyond the next one: IN_SAMPLE, and held is filled; IN_EMPTY where it was no frame, or
       where too few would stay free for its source; IN_UNBOUND without a connection. The caller sets struct_size. */
    int32_t (*hold)(void *ctx, trocar_held *held);
} trocar_in;

/* Returns at once: EXECUTED when it ran inline, QUEUED, or the reason why not. */
#define TROCAR_MODE_SEND 0u
/* Waits for the result, at most until the deadline. */
#define TROCAR_MODE_CALL 1u

/* Options and out-fields of one call. A null pointer means MODE_SEND. */
typedef struct trocar_call_opts {
    uint32_t struct_size;
    uint32_t mode;
    /* Relative, ns; 0 = the connection's default (1 s unless set), more than an hour counts as an hour.
       A command that is only sent and not begun by then never runs; with 0 the connection and the server's class
       say how long its goal is right. */
    uint64_t deadline_ns;
    /* Where the reason goes; may be null. */
    trocar_err *err;
    /* Out: stamp of the state row a read was answered from. */
    uint64_t stamp_ns;
    /* Out: 1 when the outcome is DEADLINE and the command may still run. */
    uint32_t may_still_run;
    uint32_t reserved;
} trocar_call_opts;

/* A function of a required interface. arg and ret are null where the function has none. */
typedef struct trocar_fn {
    uint32_t struct_size;
    uint32_t flags;
    void *ctx;
    trocar_outcome (*call)(void *ctx, const void *arg, void *ret, trocar_call_opts *opts);
    trocar_status (*type_of)(void *ctx, const trocar_sink *sink);
    /* Since 1.1. As call, for an untyped function: INVALID_ARGUMENT unless arg and ret_len have the sizes of the command
     * now behind it. arg is aligned to 8; a command that is only sent may leave ret out (null and 0). */
    trocar_outcome (*call_bytes)(void *ctx, trocar_bytes arg, void *ret, uint64_t ret_len, trocar_call_opts *opts);
} trocar_fn;

/* An event generator of a provided interface. */
typedef struct trocar_event {
    uint32_t struct_size;
    uint32_t flags;
    void *ctx;
    /* Broadcasts; EXECUTED, or QUEUE_FULL when at least one observer missed it (counted there). */
    trocar_outcome (*emit)(void *ctx, const void *payload);
} trocar_event;

/* The slot tables of one instance, each an array of pointers in the manifest's order. */
typedef struct trocar_ports {
    uint32_t struct_size;
    uint32_t output_count;
    uint32_t input_count;
    uint32_t function_count;
    uint32_t event_count;
    uint32_t reserved;
    const trocar_out *const *outputs;
    const trocar_in *const *inputs;
    const trocar_fn *const *functions;
    const trocar_event *const *events;
} trocar_ports;

/* Log levels of trocar_host.log. */
enum {
    TROCAR_LOG_ERROR = 1,
    TROCAR_LOG_WARN = 2,
    TROCAR_LOG_INFO = 3,
    TROCAR_LOG_DEBUG = 4,
    TROCAR_LOG_TRACE = 5
};

/* What a host offers to one instance (create: valid until destroy returns) or to a whole plugin (init: for ever). */
typedef struct trocar_host {
    uint32_t struct_size;
    uint32_t flags;
    uint32_t abi_major;
    uint32_t abi_minor;
    void *ctx;
    /* Monotonic clock, ns. Any thread. */
    uint64_t (*now_ns)(void *ctx);
    /* Any thread; from step the line is put in a bounded ring and written elsewhere. */
    void (*log)(void *ctx, uint32_t level, trocar_bytes target, trocar_bytes message);
    /* A dynamic component service, {"verb":"Create",...}. The reply arrives in on_service with the same token.
     * WOULD_BLOCK from step. */
    trocar_outcome (*service)(void *ctx, uint64_t token, trocar_bytes request);
    /* Brackets a call that comes in on a thread of the plugin's own (execution model on_callback). */
    trocar_outcome (*callback_enter)(void *ctx);
    void (*callback_leave)(void *ctx);
    /* Growth without touching this table: "trocar.parallel/1"; null when unknown. */
    const void *(*extension)(void *ctx, trocar_bytes id);
    /* Since 1.1. Asks for describe and bind between two steps: the ports are to be others. Any thread; QUEUED. */
    trocar_outcome (*ports_changed)(void *ctx);
} trocar_host;

/* The work on one slice; called from several threads at once, so data is shared. */
typedef struct trocar_slice_body {
    void *data;
    trocar_status (*run)(void *data, uint32_t slice);
} trocar_slice_body;

/* Host extension "trocar.parallel/1": the threads of the stream a component runs in. */
typedef struct trocar_parallel {
    uint32_t struct_size;
    uint32_t flags;
    void *ctx;
    /* Threads that work together now, the caller's included; 1 without a pool. */
    uint32_t (*threads)(void *ctx);
    /* Runs body once for each slice number below slices and returns when all are done: the first negative status, or
     * TROCAR_STATUS_OK. Only from step, commands and handlers of the component; not from a body. */
    trocar_status (*run)(void *ctx, uint32_t slices, const trocar_slice_body *body);
} trocar_parallel;

/* Host extension "trocar.keep/1": for code that cannot know whether somebody holds a slot or the table. */
typedef struct trocar_keep {
    uint32_t struct_size;
    uint32_t flags;
    /* All that the instance of this table was given stays as it is until the process ends, destroyed or not. ctx
     * is that of its trocar_host. Any thread, at the latest from bind or destroy. */
    void (*keep)(void *ctx);
} trocar_keep;

/* One component class. A null entry is not implemented. */
typedef struct trocar_class {
    uint32_t struct_size;
    uint32_t flags;
    trocar_bytes name;
    /* Makes an instance in its unconfigured state; null on failure with the reason in err. Opens no device. */
    void *(*create)(const trocar_host *host, trocar_bytes instance_name, trocar_err *err);
    void (*destroy)(void *self);
    /* Takes the whole configuration as JSON, already checked against the class's schema by the host. */
    trocar_status (*configure)(void *self, trocar_bytes json, trocar_err *err);
    /* Writes the class description (JSON as in the manifest) that holds for the current configuration. */
    trocar_status (*describe)(void *self, const trocar_sink *sink);
    /* Hands over the slot tables; again after describe changed them. They stay valid until the next bind or destroy. */
    trocar_status (*bind)(void *self, const trocar_ports *ports, trocar_err *err);
    trocar_status (*start)(void *self, trocar_err *err);
    trocar_status (*stop)(void *self, trocar_err *err);
    trocar_status (*resume)(void *self, trocar_err *err);
    /* Brings the device to its safe condition; called on FAULT, Stop, peer loss and shutdown. Of a class whose manifest says
     * "safe_from_any_thread": true it is called from a thread of the host's own as well, while another entry of the same
     * instance hangs, and once more by the instance's own thread when that is back, possibly at the same time: then it may
     * touch only atomics and handles made for several threads, wait for no lock another entry holds, and nothing that
     * configure, start or stop replaces. Without that word it is serialised like every other entry. */
    trocar_status (*make_safe)(void *self, trocar_err *err);
    trocar_status (*step)(void *self, const trocar_tick *tick, trocar_err *err);
    /* Executes a void, write, void-return or write-return command. ret may be null when nobody wants the value. */
    trocar_status (*command)(void *self, uint32_t id, const void *arg, void *ret, trocar_err *err);
    /* Executes a read or qualified read as a pure function of one published state row. Any thread, no instance. */
    trocar_status (*read)(const void *state_row, uint32_t id, const void *arg, void *ret, trocar_err *err);
    /* An event of a required interface. */
    trocar_status (*on_event)(void *self, uint32_t id, const void *payload, trocar_err *err);
    /* The reply to an earlier trocar_host.service, as JSON. */
    trocar_status (*on_service)(void *self, uint64_t token, trocar_bytes reply);
    /* Copies the plain state block (the manifest's state type, len bytes) to dst. */
    void (*state_copy)(void *self, void *dst, size_t len);
    /* Writes what must survive a swap and is not in the plain state block. */
    trocar_status (*snapshot)(void *self, const trocar_sink *sink);
    /* Takes a snapshot and, before it, the plain state block converted to this version's type (may be empty). */
    trocar_status (*restore)(void *self, trocar_bytes state, trocar_bytes snapshot, trocar_err *err);
    /* Growth without touching this table: "trocar.shadow/1", "trocar.selftest/1"; null when unknown. */
    const void *(*extension)(void *self, trocar_bytes id);
} trocar_class;

/* What a plugin's entry returns. */
typedef struct trocar_plugin {
    uint32_t struct_size;
    uint32_t flags;
    uint32_t abi_major;
    uint32_t abi_minor;
    trocar_bytes name;
    trocar_bytes version;
    /* Called once after dlopen, before any instance. May be null. */
    trocar_status (*init)(const trocar_host *host);
    uint32_t class_count;
    uint32_t reserved;
    /* class_count pointers, in the manifest's order. */
    const trocar_class *const *classes;
} trocar_plugin;

/* Standard payloads are 8-byte aligned; a list or text is a uint64_t length, then its room, the unused tail zero. */
typedef uint64_t trocar_stamp; /* ns of the host's monotonic clock, 0 = invalid */

#if defined(__cplusplus)
#define TROCAR_ASSERT(what, text) static_assert(what, text)
#else
#define TROCAR_ASSERT(what, text) _Static_assert(what, text)
#endif
TROCAR_ASSERT(sizeof(void *) == 8, "trocar plugins are 64-bit");
TROCAR_ASSERT(sizeof(trocar_tick) == 48, "trocar_tick");
TROCAR_ASSERT(sizeof(trocar_loan) == 40, "trocar_loan");
TROCAR_ASSERT(sizeof(trocar_sample) == 56, "trocar_sample");
TROCAR_ASSERT(sizeof(trocar_out) == 80, "trocar_out");
TROCAR_ASSERT(sizeof(trocar_held) == 40, "trocar_held");
TROCAR_ASSERT(sizeof(trocar_in) == 72, "trocar_in");
TROCAR_ASSERT(sizeof(trocar_call_opts) == 40, "trocar_call_opts");
TROCAR_ASSERT(sizeof(trocar_fn) == 40, "trocar_fn");
TROCAR_ASSERT(sizeof(trocar_event) == 24, "trocar_event");
TROCAR_ASSERT(sizeof(trocar_ports) == 56, "trocar_ports");
TROCAR_ASSERT(sizeof(trocar_host) == 80, "trocar_host");
TROCAR_ASSERT(sizeof(trocar_class) == 168, "trocar_class");
TROCAR_ASSERT(sizeof(trocar_plugin) == 72, "trocar_plugin");

/* A string literal as trocar_bytes, for static tables. */
#define TROCAR_TEXT(literal) {(const uint8_t *)(literal), sizeof(literal) - 1}

/* JSON as it stands, made a string literal: TROCAR_JSON({"name":"c"}). Pieces may stand side by side, balanced or not;
 * parentheses only inside of texts. */
#define TROCAR_JSON(...) #__VA_ARGS__

/* Places the manifest, a string literal of JSON, into the note. Once per library, at file scope. */
#define TROCAR_MANIFEST(json)                                                                \
    __attribute__((section(".note.trocar"), used, aligned(4))) static const struct {         \
        uint32_t name_size, desc_size, kind;                                                 \
        char name[8];                                                                        \
        char desc[(sizeof(json) + 3) / 4 * 4];                                               \
    } trocar_manifest_note = {7, (uint32_t)((sizeof(json) + 3) / 4 * 4), 1, "TROCAR", json}

/* Before the definition of the one exported function:
 *   TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { return &plugin; } */
#if defined(__cplusplus)
#define TROCAR_EXPORT extern "C" __attribute__((visibility("default")))
#else
#define TROCAR_EXPORT __attribute__((visibility("default")))
#endif
TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void);

#ifdef __cplusplus
}
#endif
#endif
