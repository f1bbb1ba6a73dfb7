//! Both session machines against each other, frame by frame, without any transport.
//!
//! | module | content |
//! | --- | --- |
//! | `handshake` | versions, worlds, tokens, order |
//! | `views` | selection, order, settling, prefetch, limits |
//! | `credit` | grants in chunks and bytes |
//! | `requests` | explicit requests, cancellation, load shedding |
//! | `deliveries` | exact, seed-only, quantised |
//! | `refined` | refined frames and the reference window |
//! | `frames` | malformed frames |

mod credit;
mod deliveries;
mod frames;
mod handshake;
mod pair;
mod refined;
mod requests;
mod views;
