//! The HTTP side over real connections.
//!
//! | module | what belongs there |
//! | --- | --- |
//! | `caching` | validators, conditional requests, what caches are told |
//! | `origins` | what pages of other origins may do |
//! | `refusals` | typed refusals, counted, and that nothing else suffers |
//! | `disk` | what a restart finds again, and what it must not serve |
//! | `map` | tiles of the relief map |
//! | `live` | who is where |
//! | `page` | the page's parts and its policy |
//! | `openapi` | that the document tells the truth |

mod caching;
mod client;
mod disk;
mod live;
mod map;
mod openapi;
mod origins;
mod page;
mod refusals;
