// Numbers of JSON in a process whose locale has a comma, and members whose sizes are not the manifest's.
// Exits with 0 when all is as it should be; the first argument is a locale with a decimal comma, or nothing
// where the machine has none.
#include "trocar_plugin.hpp"

#include <clocale>
#include <cstdio>

namespace {

int failures = 0;
void expect(bool good, const char *what) {
    if (!good) {
        std::printf("wrong: %s\n", what);
        ++failures;
    }
}

template <class F> std::string refusal(F &&f) {
    try {
        f();
        return "none";
    } catch (const trocar::Refused &e) {
        return e.what();
    }
}
template <class F> void refused(F &&f, const char *what) { expect(refusal(f).find(what) != std::string::npos, what); }

trocar::Json of(const char *text) { return trocar::Json::parse(text); }

void numbers_are_what_their_digits_say() {
    expect(of("50.5").number() == 50.5 && of("-1.25e-3").number() == -0.00125, "a fraction");
    expect(of("9007199254740992").number() == 9007199254740992.0, "a whole number that is a double");
    refused([] { of("9007199254740993").number(); }, "9007199254740993 is not exact as a double");
    refused([] { of("99999999999999999999").number(); }, "99999999999999999999 is not exact");
    expect(of("-9223372036854775808").number() == -0x1p63, "the lowest of 64 bit is a double");
    for (const char *bad : {"1e999", "1,5", "1.2.3", "-", "+-1"}) refused([&] { of(bad).number(); }, "");
    refused([] { of("[1e999]"); }, "1e999 is no number of JSON");
}

void whole_numbers_are_exact_or_refused() {
    expect(of("9007199254740993").u64() == 9007199254740993u && of("\"9007199254740993\"").i64() == 9007199254740993, "2^53 + 1");
    expect(of("18446744073709551615").u64() == UINT64_MAX && of("9223372036854775807").i64() == INT64_MAX, "the highest");
    expect(of("-9223372036854775808").i64() == INT64_MIN && of("-0").u64() == 0, "the lowest");
    expect(of("5.0").u64() == 5 && of("2e3").i64() == 2000 && of("-7.0").i64() == -7, "whole, otherwise written");
    expect(of("{}")["none"].u64(7) == 7 && of("null").i64(-7) == -7, "what is not there");
    refused([] { of("18446744073709551616").u64(); }, "18446744073709551616 is no whole number of 64 bit");
    refused([] { of("9223372036854775808").i64(); }, "9223372036854775808 is no whole number from");
    refused([] { of("-9223372036854775809").i64(); }, "-9223372036854775809 is no whole number from");
    refused([] { of("-1").u64(); }, "-1 is no whole number from 0");
    refused([] { of("9007199254740993.0").u64(); }, "9007199254740993.0 is no whole number written with its digits alone");
    refused([] { of("1.5").i64(); }, "1.5 is no whole number");
    refused([] { of("\"ten\"").i64(); }, "\"ten\" is none");
    refused([] { of("true").u64(); }, "a whole number is wanted");
}

void what_is_written_is_read_back() {
    for (const double v : {0.1, -50.5, 1e300, 5e-324, 0.0}) expect(of(trocar::written(v).c_str()).number() == v, "a double");
    expect(trocar::written(UINT64_MAX) == "18446744073709551615" && trocar::written(INT64_MIN) == "-9223372036854775808", "64 bit");
    const std::string text = "a \"b\" \\ \n\x01 \u00b5";
    expect(of(trocar::written(text).c_str()).string() == text, "a text");
    expect(trocar::written(true) == "true" && trocar::written("x") == "\"x\"", "words");
    refused([] { trocar::written(HUGE_VAL); }, "no infinity");
}

struct Pair {
    double a, b;
};
template <int WRONG> struct Sized : trocar::Component {
    template <int HERE> using Of = std::conditional_t<WRONG == HERE, Pair, double>;
    trocar::In<Of<1>> in;
    trocar::Out<Of<2>> out;
    trocar::FrameIn<Of<3>> frames;
    trocar::FrameOut<Of<4>> images;
    trocar::Function<Of<5>, Of<6>> ask;
    trocar::Event<Of<7>> over;
    Of<8> state = {};

    Of<9> set(Of<10>) { return {}; }
    static Of<11> get(const Of<8> &, Of<12>) { return {}; }
    void rang(Of<13>) {}
    static void members(trocar::Members<Sized> &m) {
        m.input("in", &Sized::in);
        m.output("out", &Sized::out);
        m.input("frames", &Sized::frames);
        m.output("images", &Sized::images);
        m.function("peer/ask", &Sized::ask);
        m.event("ctl/over", &Sized::over);
        m.command("ctl/set", &Sized::set);
        m.read("ctl/get", &Sized::get);
        m.on("peer/rang", &Sized::rang);
        m.state(&Sized::state);
    }
};

const trocar::Json manifest = trocar::Json::parse(R"({"name":"sized",
 "inputs":[{"name":"in","type":{"plain":"f64"}},{"name":"frames","type":{"frame":"f64","format":"x"}}],
 "outputs":[{"name":"out","type":{"plain":{"array":"f32","n":2}}},{"name":"images","type":{"frame":{"ref":"One"}}}],
 "required":[{"name":"peer","functions":[{"name":"ask","arg":"u64","ret":"i64"}],"handlers":[{"name":"rang","payload":"f64"}]}],
 "provided":[{"name":"ctl","commands":[{"name":"set","kind":"write_return","arg":{"type":"f64"},"ret":"f64"},
  {"name":"get","kind":"qualified_read","arg":{"type":"f64"},"ret":"stamp"}],"events":[{"name":"over","payload":"f64"}]}],
 "state":{"ref":"One"}})");
const trocar::Json types = trocar::Json::parse(R"([{"name":"One","size":8,"align":8,"fields":[]}])");

template <int WRONG> std::string said() {
    trocar_host host = {};
    host.struct_size = sizeof host;
    uint8_t room[256];
    trocar_err err = {room, sizeof room, 0};
    const trocar_class *c = trocar::Table<Sized<WRONG>>::make(manifest, types);
    void *self = c->create(&host, trocar::bytes("s"), &err);
    if (self == nullptr) return std::string(reinterpret_cast<const char *>(room), err.len);
    c->destroy(self);
    return "made";
}
template <int WRONG> void differs(const char *member) {
    expect(said<WRONG>().find(member) == 0 && said<WRONG>().find("16 bytes in the code and 8 in the manifest") != std::string::npos,
           said<WRONG>().c_str());
}

void a_member_of_another_size_is_refused() {
    expect(said<0>() == "made", said<0>().c_str());
    differs<1>("in: the sample");
    differs<2>("out: the sample");
    differs<3>("frames: the header of a frame");
    differs<4>("images: the header of a frame");
    differs<5>("peer/ask: the argument");
    differs<6>("peer/ask: the result");
    differs<7>("ctl/over: the payload");
    differs<8>("ctl/get: the state");
    differs<9>("ctl/set: the result");
    differs<10>("ctl/set: the argument");
    differs<11>("ctl/get: the result");
    differs<12>("ctl/get: the argument");
    differs<13>("peer/rang: the payload");
}

} // namespace

int main(int argc, char **argv) {
    if (argc > 1 && std::setlocale(LC_NUMERIC, argv[1]) == nullptr) {
        std::printf("no locale %s\n", argv[1]);
        return 2;
    }
    if (argc > 1) expect(std::atof("1.5") == 1.0, "the locale has a comma");
    numbers_are_what_their_digits_say();
    whole_numbers_are_exact_or_refused();
    what_is_written_is_read_back();
    a_member_of_another_size_is_refused();
    return failures == 0 ? 0 : 1;
}
