// Inputs and outputs of frames: a plain header and bytes in the host's pooled memory, never copied on the
// way.
//
// Invariant: what an input shows is valid until it is asked again; a loan that is not committed goes back by
// itself.
#ifndef TROCAR_FRAMES_HPP
#define TROCAR_FRAMES_HPP

#include "trocar_plugin.h"

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace trocar {

// Whether an image lies in `size` bytes from `offset` on, as a frame's header, a peer's word, says: `height`
// rows, `stride` bytes apart, of `width` pixels of `pixel` bytes. Without overflow, whatever the numbers; ask
// it before touching a row.
constexpr bool image_fits(uint64_t size, uint32_t width, uint32_t height, uint32_t stride, uint32_t pixel,
                          uint64_t offset = 0) {
    const uint64_t row = uint64_t(width) * pixel;
    if (row == 0 || height == 0 || stride < row || offset > size || row > size - offset) return false;
    // The last row needs no gap behind it.
    return uint64_t(height - 1) * stride <= size - offset - row;
}

template <class H> class FrameOut;

// An input of frames with the header H; unbound until the host ties it.
template <class H> class FrameIn {
    static_assert(std::is_trivially_copyable_v<H>, "headers are plain data");

  public:
    // Each frame once, in order (an input with "fifo").
    bool next() { return take(true); }
    // The newest frame, seen or not.
    bool latest() { return take(false); }
    // The newest frame when it was not seen before.
    bool fresh() { return take(false) && (view_.flags & TROCAR_SAMPLE_FRESH) != 0; }
    // Of the frame taken last; only after one of the above said true.
    const H &header() const { return *static_cast<const H *>(view_.header); }
    const uint8_t *bytes() const { return view_.bytes; }
    size_t size() const { return view_.bytes == nullptr ? 0 : static_cast<size_t>(view_.len); }
    // The same bytes for changing in place, when this input is their only owner; else null.
    uint8_t *writable() { return held() ? slot_->writable(slot_->ctx, &view_) : nullptr; }
    uint64_t stamp() const { return view_.stamp_ns; }
    uint64_t seq() const { return view_.seq; }
    bool stale() const { return (view_.flags & TROCAR_SAMPLE_STALE) != 0; }
    // Hands the frame back early.
    void release() {
        if (held()) slot_->release(slot_->ctx);
        view_ = {};
    }
    void tie(const trocar_in *slot) {
        slot_ = slot;
        view_ = {};
    }

  private:
    template <class> friend class FrameOut;
    bool held() const { return slot_ != nullptr && view_.header != nullptr; }
    bool take(bool next) {
        view_ = {};
        if (slot_ == nullptr) return false;
        view_.struct_size = sizeof view_;
        const int32_t there = (next ? slot_->next : slot_->latest)(slot_->ctx, &view_);
        if (there != TROCAR_IN_SAMPLE) view_ = {};
        return held();
    }
    const trocar_in *slot_ = nullptr;
    trocar_sample view_ = {};
};

// An output of frames with the header H.
template <class H> class FrameOut {
    static_assert(std::is_trivially_copyable_v<H>, "headers are plain data");

  public:
    FrameOut() = default;
    FrameOut(const FrameOut &) = delete;
    FrameOut &operator=(const FrameOut &) = delete;

    // Makes the pool: so many frames of up to max_bytes. From configure and start only.
    trocar_outcome reserve(uint64_t max_bytes, uint32_t frames) {
        max_bytes_ = max_bytes;
        frames_ = frames;
        return slot_ == nullptr ? static_cast<trocar_outcome>(TROCAR_UNBOUND)
                                : slot_->reserve(slot_->ctx, max_bytes, frames);
    }
    // Room for one frame; EXHAUSTED when every one is in use. One that is open already goes back.
    trocar_outcome loan() {
        cancel();
        if (slot_ == nullptr) return TROCAR_UNBOUND;
        loan_.struct_size = sizeof loan_;
        const trocar_outcome outcome = slot_->loan(slot_->ctx, &loan_);
        open_ = outcome == TROCAR_EXECUTED;
        return outcome;
    }
    // Of the open loan; only after loan() gave EXECUTED.
    H &header() { return *static_cast<H *>(loan_.header); }
    uint8_t *bytes() { return open_ ? loan_.bytes : nullptr; }
    size_t capacity() const { return open_ ? static_cast<size_t>(loan_.capacity) : 0; }
    // Publishes the open loan with its first len bytes; stamp in ns of the host's clock.
    trocar_outcome commit(size_t len, uint64_t stamp_ns) {
        if (!open_ || len > loan_.capacity) return TROCAR_INVALID_ARGUMENT;
        open_ = false;
        return slot_->commit(slot_->ctx, &loan_, len, stamp_ns);
    }
    void cancel() {
        if (open_) slot_->cancel(slot_->ctx, &loan_);
        open_ = false;
        loan_ = {};
    }
    // Publishes the frame an input holds, without a copy.
    trocar_outcome forward(const FrameIn<H> &from, uint64_t stamp_ns) {
        if (slot_ == nullptr) return TROCAR_UNBOUND;
        return from.held() ? slot_->forward(slot_->ctx, &from.view_, stamp_ns)
                           : static_cast<trocar_outcome>(TROCAR_INVALID_ARGUMENT);
    }
    void tie(const trocar_out *slot) {
        if (slot != slot_) open_ = false;
        slot_ = slot;
        if (slot_ != nullptr && frames_ > 0) slot_->reserve(slot_->ctx, max_bytes_, frames_);
    }

  private:
    const trocar_out *slot_ = nullptr;
    trocar_loan loan_ = {};
    bool open_ = false;
    uint64_t max_bytes_ = 0;
    uint32_t frames_ = 0;
};

} // namespace trocar

#endif
