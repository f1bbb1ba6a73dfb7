//! Hostile clients over real connections: each is refused, bounded or ended by a documented limit,
//! and other clients are served meanwhile. Servers in this process run on the thread of their test,
//! whose bytes are counted. The test `hostile_sockets` of the crate `tests` has further clients of
//! this kind.
//!
//! | module | subject |
//! | --- | --- |
//! | `heads` | heads of requests over their limit, and the memory of those below it |
//! | `stalls` | heads byte by byte, and connections without a byte |
//! | `pings` | a flood of pings whose pongs are not read |
//! | `slow_readers` | a download and a session that are read byte by byte |
//! | `storms` | a thousand sessions of one address, one after the other |
//! | `resets` | connections that end with a reset, in each state of theirs |
//! | `credit` | grants of zero, of too much, and sums over the limit |
//! | `draining` | requests to a program that ends |

mod client;
mod credit;
#[cfg(unix)]
mod draining;
mod heads;
mod pings;
mod resets;
mod slow_readers;
mod stalls;
#[cfg(target_os = "linux")]
mod storms;

use test_support::counting_allocator::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;
