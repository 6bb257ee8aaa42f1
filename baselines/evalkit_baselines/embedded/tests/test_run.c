/* Output of evalkit-run. */
#define main evalkit_run
#include "../main.c"
#undef main

#include "check.h"

static void stamps_have_one_sign_and_nine_digits(void)
{
    static const int64_t stamps[] = {0, 1500000000, -1500000000, -1, INT64_MIN};
    static const char *const texts[] = {"0.000000000", "1.500000000", "-1.500000000", "-0.000000001",
                                        "-9223372036.854775808"};
    for (size_t k = 0; k < sizeof stamps / sizeof *stamps; k++) {
        char text[32] = "";
        FILE *const file = tmpfile();
        CHECK(file != NULL);
        if (file) {
            write_stamp(file, stamps[k]);
            rewind(file);
            CHECK(fgets(text, sizeof text, file) != NULL && strcmp(text, texts[k]) == 0);
            fclose(file);
        }
    }
}

int main(void)
{
    char name[] = "evalkit-run", *alone[] = {name, NULL};
    stamps_have_one_sign_and_nine_digits();
    CHECK(evalkit_run(1, alone) == 2);
    return verdict();
}
