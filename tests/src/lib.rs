//! The harness of the suites under `tests/tests`: a server on a free port, WebSocket clients, HTTP,
//! headless rendering, and picture comparison.
//!
//! | suite | content |
//! | --- | --- |
//! | `culling` | vegetation culling: the GPU against the twin on the CPU |
//! | `culling_extremes` | vegetation culling at extreme eyes and shapes of land |
//! | `delivery` | exact, refined, quantised and seed-only delivery; faulty servers |
//! | `extremes` | extreme eyes, lenses, sizes and shapes of land |
//! | `far` | pictures are independent of the distance from the origin |
//! | `faults` | servers that go away, and clients that reconnect |
//! | `ground_relief` | parallax on the streamed land |
//! | `harness` | the harness itself, and this table |
//! | `hostile` | peers that violate the protocol; other sessions are unaffected |
//! | `hostile_sockets` | heads without end, floods of pings, slow readers, storms, resets |
//! | `http` | probes, metrics, the description of the world, chunk downloads |
//! | `light` | finite light in every pixel, for every sun, height and direction |
//! | `networks` | bad networks: slow, sliced, cut, reset, silent |
//! | `pictures` | the headless viewer against golden pictures |
//! | `pictures_gallery` | poses of the gallery against golden thumbnails |
//! | `programs` | the built binaries: options, exit codes, messages |
//! | `relief` | parallax scenes: identities, extreme settings, displaced geometry |
//! | `shadows` | terrain shadows against their definition and in pictures |
//! | `streaming` | the stream of a correct client over real sockets |
//! | `tls` | viewer and load test over TLS |
//! | `tree_shade` | shadows of trees against rays through all trees |
//! | `water` | the sea and the water scene: identities, tiers, extreme cameras |

#![forbid(unsafe_code)]

pub mod deformed_source;
pub mod faulty_server;
pub mod golden;
pub mod horizon;
pub mod peer;
pub mod places;
pub mod program;
pub mod rendering;
pub mod running;
pub mod toxic_proxy;

pub use peer::Peer;
pub use rendering::{gpu_is_required, gpu_or_skip, open_gpu_or_skip, options_at, render_or_skip, view_at};
pub use running::RunningServer;
