/* Tells the thread sanitizer what the prebuilt standard library orders: the slow paths of its locks, and fences.
 *
 * The linker leads every call of these functions of std through here (`--wrap`, see `tests/run`). Invariant: an edge is told
 * exactly where std makes one, from the release to the acquire of the same address; anything more would hide real races. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

void __tsan_acquire(void *address);
void __tsan_release(void *address);

/* A lock that was contended is taken inside std; its release is inlined and so is seen already. */
void std_mutex_lock_contended(void *mutex);
void seen_mutex_lock_contended(void *mutex) {
  std_mutex_lock_contended(mutex);
  __tsan_acquire(mutex);
}

void std_rwlock_read_contended(void *lock);
void seen_rwlock_read_contended(void *lock) {
  std_rwlock_read_contended(lock);
  __tsan_acquire(lock);
}

void std_rwlock_write_contended(void *lock);
void seen_rwlock_write_contended(void *lock) {
  std_rwlock_write_contended(lock);
  __tsan_acquire(lock);
}

/* Waiting gives the mutex back and takes it again, both inside std. */
void std_condvar_wait(void *condvar, void *mutex);
void seen_condvar_wait(void *condvar, void *mutex) {
  __tsan_release(mutex);
  std_condvar_wait(condvar, mutex);
  __tsan_acquire(mutex);
}

bool std_condvar_wait_timeout(void *condvar, void *mutex, uint64_t seconds, uint32_t nanoseconds);
bool seen_condvar_wait_timeout(void *condvar, void *mutex, uint64_t seconds, uint32_t nanoseconds) {
  __tsan_release(mutex);
  bool in_time = std_condvar_wait_timeout(condvar, mutex, seconds, nanoseconds);
  __tsan_acquire(mutex);
  return in_time;
}

/* Who runs a Once publishes what its closure made by a store inside std, so the release goes to the end of the closure, a
 * `&mut dyn FnMut(&OnceState)`. */
struct vtable {
  void *drop;
  size_t size, align;
  void *call_once;
  void (*call_mut)(void *closure, void *state);
};
struct making {
  void *once, *closure;
  const struct vtable *table;
};
static void make_and_release(void *making, void *state) {
  struct making *m = making;
  m->table->call_mut(m->closure, state);
  __tsan_release(m->once);
}

void std_once_call(void *once, bool again, void *closure, const struct vtable *table);
void seen_once_call(void *once, bool again, void *closure, const struct vtable *table) {
  struct making making = {once, closure, table};
  struct vtable through = *table;
  through.call_mut = make_and_release;
  std_once_call(once, again, &making, &through);
  __tsan_acquire(once);
}

/* Arc gives up its share by `fetch_sub(Release)`, and the last one orders itself behind the others by `fence(Acquire)`,
 * which the sanitizer ignores: here the fence acquires what this thread subtracted from last, and nothing else. */
enum { ACQUIRE = 2, RELEASE = 3 };
static __thread void *subtracted_from;

uint64_t __real___tsan_atomic64_fetch_sub(void *address, uint64_t value, int order);
uint64_t __wrap___tsan_atomic64_fetch_sub(void *address, uint64_t value, int order) {
  uint64_t before = __real___tsan_atomic64_fetch_sub(address, value, order);
  subtracted_from = order == RELEASE ? address : NULL;
  return before;
}

void __real___tsan_atomic_thread_fence(int order);
void __wrap___tsan_atomic_thread_fence(int order) {
  __real___tsan_atomic_thread_fence(order);
  if (order == ACQUIRE && subtracted_from != NULL) __tsan_acquire(subtracted_from);
  subtracted_from = NULL;
}
