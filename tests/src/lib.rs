//! The harness of the suites under `tests/tests`: a server on port 0, a raw WebSocket peer, HTTP,
//! and picture comparison.
//!
//! | suite | what belongs there |
//! | --- | --- |
//! | `streaming` | what a well-behaved client gets over real sockets |
//! | `delivery` | exact and seed-only delivery: equal land, equal pictures, servers that lie |
//! | `hostile` | peers that break the rules, and that the others do not notice |
//! | `http` | probes, metrics, the world's description, chunk downloads |
//! | `faults` | servers that go away, and clients that live on |
//! | `far` | that a picture does not depend on the distance from the origin |
//! | `light` | that no sun, height or direction leaves a pixel without light |
//! | `ground_relief` | parallax on the streamed land |
//! | `extremes` | eyes, lenses, sizes and shapes of land at their ends |
//! | `pictures` | what the headless viewer draws, against golden pictures |
//! | `shadows` | the land's shadow on itself, against its definition and in pictures |
//! | `programs` | the built binaries: options, exit codes, messages |
//! | `harness` | that the harness itself fails when it should |

#![forbid(unsafe_code)]

pub mod golden;
pub mod horizon;
pub mod liar;
pub mod molded;
pub mod peer;
pub mod program;
pub mod running;

pub use peer::Peer;
pub use running::RunningServer;

/// Whether a missing GPU adapter is a failure instead of a visible skip. Continuous integration
/// installs a software driver and sets `TOMBOLO_REQUIRE_GPU`, so that the pictures cannot go
/// untested there.
#[must_use]
pub fn gpu_is_required() -> bool {
    std::env::var_os("TOMBOLO_REQUIRE_GPU").is_some()
}
