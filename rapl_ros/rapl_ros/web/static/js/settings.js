// What this browser remembers.

const KEY = "rapl";

function read() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? {};
  } catch {
    return {};
  }
}

const values = read();

export const settings = new Proxy(values, {
  set(target, name, value) {
    target[name] = value;
    try {
      localStorage.setItem(KEY, JSON.stringify(target));
    } catch {
      // private browsing: it holds until the page is closed
    }
    return true;
  },
});
