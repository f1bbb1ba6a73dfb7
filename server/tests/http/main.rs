//! The HTTP side over real connections.
//!
//! | module | what belongs there |
//! | --- | --- |
//! | `caching` | validators, conditional requests, what caches are told |
//! | `origins` | what pages of other origins may do |
//! | `refusals` | typed refusals, counted, and that nothing else suffers |
//! | `map` | tiles of the relief map |
//! | `live` | who is where |
//! | `page` | the page's parts and its policy |
//! | `openapi` | that the document tells the truth |

mod caching;
mod client;
mod live;
mod map;
mod openapi;
mod origins;
mod page;
mod refusals;
