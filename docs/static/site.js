/* The button for light and dark is called by its name, not by its icons, which turn from <i> into
   <svg> while the page loads. */
for (const event of ["DOMContentLoaded", "load"]) {
    window.addEventListener(event, () => {
        for (const icon of document.querySelectorAll(".theme-switch-button :is(i, svg)")) {
            icon.setAttribute("aria-hidden", "true");
            icon.removeAttribute("aria-labelledby");
            icon.removeAttribute("title");
            icon.querySelector("title")?.remove();
        }
    });
}
