// Entries that throw nothing: an exception is a status and a sentence.
//
// Invariant: no exception passes from a plugin into the host.
#ifndef TROCAR_GUARD_HPP
#define TROCAR_GUARD_HPP

#include "trocar_json.hpp"

#include <algorithm>
#include <cstring>
#include <exception>
#include <string_view>

namespace trocar {

inline trocar_status say(trocar_err *err, trocar_status status, std::string_view why) {
    if (err != nullptr && err->ptr != nullptr) {
        err->len = std::min(why.size(), err->cap);
        std::memcpy(err->ptr, why.data(), err->len);
    }
    return status;
}

// Runs an entry; nothing is thrown out of it. refusal: what a Refused without a status of its own is here.
template <class F>
trocar_status guarded(trocar_err *err, F &&entry, trocar_status refusal = TROCAR_STATUS_FAILED) noexcept {
    try {
        entry();
        return TROCAR_STATUS_OK;
    } catch (const Refused &e) {
        return say(err, e.status == TROCAR_STATUS_OK ? refusal : e.status, e.what());
    } catch (const std::exception &e) {
        return say(err, TROCAR_STATUS_PANICKED, e.what());
    } catch (...) {
        return say(err, TROCAR_STATUS_PANICKED, "an exception of unknown type");
    }
}

} // namespace trocar

#endif
