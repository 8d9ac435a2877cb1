#!/usr/bin/env bash
# Prints the linker arguments that lead the calls of std's locks through std.c; builds it into the directory given.
#
# Invariant: a function that this toolchain's std no longer has is an error with its name, never left out: without it the
# sanitizer would report races that are none.
set -eu -o pipefail
into=$1
cd "$(dirname "$0")"

# Name in std.c, and how the mangled name of what it stands for ends.
wrapped=(
  "mutex_lock_contended 5mutex5futexNt[0-9A-Za-z_]*_5Mutex14lock_contended"
  "rwlock_read_contended 6rwlock5futexNt[0-9A-Za-z_]*_6RwLock14read_contended"
  "rwlock_write_contended 6rwlock5futexNt[0-9A-Za-z_]*_6RwLock15write_contended"
  "condvar_wait 7condvar5futexNt[0-9A-Za-z_]*_7Condvar4wait"
  "condvar_wait_timeout 7condvar5futexNt[0-9A-Za-z_]*_7Condvar12wait_timeout"
  "once_call 4once5futexNt[0-9A-Za-z_]*_4Once4call"
)
std=$(ls "$(rustc --print target-libdir)"/libstd-*.so)
exported=$(nm -D --defined-only "$std" | awk '{ print $3 }')
defines=() arguments=(-Wl,--wrap=__tsan_atomic64_fetch_sub -Wl,--wrap=__tsan_atomic_thread_fence)
for entry in "${wrapped[@]}"; do
  read -r name ending <<<"$entry"
  symbol=$(grep -E "$ending\$" <<<"$exported") || {
    echo "tests/tsan: $(rustc --version) has no function like '$ending' (for $name in tests/tsan/std.c): see what its lock calls now" >&2
    exit 1
  }
  defines+=("-Dstd_$name=__real_$symbol" "-Dseen_$name=__wrap_$symbol")
  arguments+=("-Wl,--wrap=$symbol")
done

# Named after what is in it: the path stands in RUSTFLAGS, so that cargo builds anew what was linked with another.
name=std-$( (cat std.c link.sh && rustc -vV) | cksum | cut -d' ' -f1)
mkdir -p "$into"
"${CC:-cc}" -O1 -fPIC -Wall -Wextra -Werror "${defines[@]}" -c std.c -o "$into/$name.o"
printf '%s\n' "$into/$name.o" "${arguments[@]}" >"$into/$name.args"
echo "@$into/$name.args"
