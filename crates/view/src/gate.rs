//! Access: the names by which the server is called, the pages that may call it, and the token.
//!
//! A page of another site cannot read answers, but could send requests, or make its own name point
//! to this machine. So `Host` must be a loopback name or an address of this machine, `Origin` must
//! be this server, and an address that others reach needs the token of the printed URL, which the
//! page keeps as a cookie.

use std::net::{IpAddr, SocketAddr};

use hyper::HeaderMap;
use hyper::header::{COOKIE, HOST, HeaderName, ORIGIN};

/// The cookie with the token.
const COOKIE_NAME: &str = "luxel_token";
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// The verdict on a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It is let in.
    Welcome,
    /// It is let in, and brought the token in its address: answer with the cookie.
    WelcomeWithToken,
    /// It is refused, for this reason.
    Refused(&'static str),
}

/// The rules of one server.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    address: SocketAddr,
    token: Option<String>,
}

impl Gate {
    /// Returns the rules for a server at `address`: a loopback address needs no token.
    pub(crate) fn new(address: SocketAddr) -> Result<Self, getrandom::Error> {
        let token = if address.ip().is_loopback() { None } else { Some(new_token()?) };
        Ok(Self { address, token })
    }

    /// Returns the address to open in a browser.
    pub(crate) fn url(&self) -> String {
        let port = self.address.port();
        let ip = match self.address.ip() {
            // Every address of this machine; the name of the machine is for the user to put in.
            IpAddr::V4(ip) if ip.is_unspecified() => "127.0.0.1".into(),
            IpAddr::V6(ip) if ip.is_unspecified() => "[::1]".into(),
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        let query = self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
        format!("http://{ip}:{port}/{query}")
    }

    /// Returns the `Set-Cookie` that keeps the token.
    pub(crate) fn cookie(&self) -> Option<String> {
        self.token.as_ref().map(|token| format!("{COOKIE_NAME}={token}; Path=/; HttpOnly; SameSite=Strict"))
    }

    /// Judges a request by its headers and the token in its query, if there is one.
    pub(crate) fn judge(&self, headers: &HeaderMap, query_token: Option<&str>) -> Verdict {
        let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or("\u{fffd}"));
        let Some(host) = text(HOST).filter(|host| self.is_own(host)) else {
            return Verdict::Refused("the Host header names another machine; open the address that luxel printed");
        };
        let is_foreign = text(ORIGIN).is_some_and(|origin| origin.strip_prefix("http://") != Some(host));
        if is_foreign || text(SEC_FETCH_SITE) == Some("cross-site") {
            return Verdict::Refused("pages of other sites may not use this viewer");
        }
        let Some(token) = &self.token else { return Verdict::Welcome };
        if query_token.is_some_and(|given| is_same(given, token)) {
            return Verdict::WelcomeWithToken;
        }
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(';'));
        let mut pairs = cookies.filter_map(|cookie| cookie.trim().split_once('='));
        match pairs.any(|(name, value)| name == COOKIE_NAME && is_same(value, token)) {
            true => Verdict::Welcome,
            false => Verdict::Refused("the token is missing or wrong; open the whole address that luxel printed"),
        }
    }

    /// Returns whether a `Host` is a name of this machine. Ports are not compared: a tunnel has its
    /// own.
    fn is_own(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split_once(']').map(|(name, _)| name),
            None => Some(host.rsplit_once(':').map_or(host, |(name, _)| name)),
        };
        let Some(name) = name else { return false };
        match name.parse::<IpAddr>() {
            // A name cannot be made to be an address, so that addresses are safe where the server
            // listens to all.
            Ok(ip) => ip.is_loopback() || ip == self.address.ip() || self.address.ip().is_unspecified(),
            Err(_) => name.eq_ignore_ascii_case("localhost"),
        }
    }
}

/// Compares without telling by the time where the difference is.
fn is_same(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |differences, (a, b)| differences | (a ^ b)) == 0
}

fn new_token() -> Result<String, getrandom::Error> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use hyper::header::HeaderValue;

    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (HeaderName::from_static(name), HeaderValue::from_str(value).unwrap())).collect()
    }

    fn is_refused(verdict: Verdict) -> bool {
        matches!(verdict, Verdict::Refused(_))
    }

    #[test]
    fn loopback_is_called_by_its_names_on_any_port() {
        let gate = Gate::new("127.0.0.1:7007".parse().unwrap()).unwrap();
        assert_eq!((gate.url().as_str(), gate.cookie()), ("http://127.0.0.1:7007/", None));
        for host in ["127.0.0.1:7007", "localhost:8080", "localhost", "[::1]:7007", "127.0.0.1"] {
            assert_eq!(gate.judge(&headers(&[("host", host)]), None), Verdict::Welcome, "{host}");
        }
        for host in ["evil.example:7007", "127.0.0.1.evil.example", "192.168.0.1:7007", "localhost.evil.example", "", "["] {
            assert!(is_refused(gate.judge(&headers(&[("host", host)]), None)), "{host}");
        }
        assert!(is_refused(gate.judge(&headers(&[]), None)));
    }

    #[test]
    fn pages_of_other_sites_are_refused() {
        let gate = Gate::new("127.0.0.1:7007".parse().unwrap()).unwrap();
        let judge = |origin| gate.judge(&headers(&[("host", "localhost:7007"), ("origin", origin)]), None);
        assert_eq!(judge("http://localhost:7007"), Verdict::Welcome);
        for origin in ["http://localhost:7008", "https://localhost:7007", "http://evil.example", "null"] {
            assert!(is_refused(judge(origin)), "{origin}");
        }
        assert!(is_refused(gate.judge(&headers(&[("host", "localhost:7007"), ("sec-fetch-site", "cross-site")]), None)));
    }

    #[test]
    fn an_address_that_others_reach_needs_the_token() {
        let gate = Gate::new("0.0.0.0:7007".parse().unwrap()).unwrap();
        let token = gate.token.clone().unwrap();
        assert_eq!(gate.url(), format!("http://127.0.0.1:7007/?token={token}"));
        let from = |more: &[(&'static str, &str)]| headers(&[&[("host", "192.168.0.1:7007")], more].concat());
        assert!(is_refused(gate.judge(&from(&[]), None)));
        assert!(is_refused(gate.judge(&from(&[]), Some("0123"))));
        assert_eq!(gate.judge(&from(&[]), Some(&token)), Verdict::WelcomeWithToken);
        assert_eq!(gate.judge(&from(&[("cookie", &format!("a=b; luxel_token={token}"))]), None), Verdict::Welcome);
        assert!(is_refused(gate.judge(&from(&[("cookie", "luxel_token=0")]), None)));
        assert!(is_refused(gate.judge(&headers(&[("host", "evil.example")]), Some(&token))));
    }
}
