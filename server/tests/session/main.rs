//! Sessions without a network, in virtual time: minutes pass as soon as everybody waits.
//!
//! | module | what belongs there |
//! | --- | --- |
//! | `silence` | when a peer that says nothing is ended |
//! | `cost` | what an address that has spent its share gets |
//! | `heed` | how long a session that is refused much is not listened to |

mod cost;
mod heed;
mod peer;
mod silence;
