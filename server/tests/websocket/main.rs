//! Conformance of the WebSocket layer with RFC 6455: tables of cases against an echo built from it,
//! in the groups of Autobahn|Testsuite, and the same violations in sessions.
//!
//! | module | subject |
//! | --- | --- |
//! | `cases` | what a client sends and what an echo must answer, one file for each group |
//! | `conformance` | runs every case, whole and in parts; planted faults must be found |
//! | `frame` | frames as clients may and may not send them |
//! | `echo` | the echo |
//! | `echo_server` | the echo over TCP, as the example `echo` |
//! | `handshake` | the opening handshake |
//! | `sessions` | close codes of sessions, and Close frames that must not be lost |

mod cases;
mod conformance;
mod echo;
mod echo_server;
mod frame;
mod handshake;
mod sessions;
